"""Names and limits that settings share with the rooms that give them a meaning; the standard library alone.

Settings, options and help need the names of metrics, searches or casters, not NumPy, which takes longer to import than
help takes to print. A test holds each list to what its room has.
"""

CASTERS = ("raster", "embree", "bvh", "exact")  # in the order in which "auto" tries them; the last it does not
DETAILS = ("box", "body", "detailed")  # of vehicles, the coarsest first
BOX_KINDS = ("structure", "building", "vegetation")
BARRIERS = ("concrete", "guard_rail", "hedge")
VEHICLE_CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle")
CLASSES = (*VEHICLE_CLASSES, "pedestrian")  # of road users
KINDS = ("car", "truck or bus", "motorcycle")  # of vehicles, which detectors tell apart; a van is a car
TRAFFIC_FORMATS = ("auto", "ngsim", "sumo", "table", "highd", "ind", "k733", "tgsim")
# Of what cannot be true of traffic.
WARNINGS = ("grade", "sizes", "time-step", "tracks", "headings", "drift", "bend", "carriageway", "overlaps")
FRAMES = "frames"  # what is accepted where two inputs do not fit
SENSOR_SUFFIXES = (".toml", ".csv", ".txt", ".tsv", ".dat", ".json", ".yaml", ".yml")
CLOUD_SUFFIXES = (".npz", ".pcd", ".ply", ".bin", ".las", ".laz")
DATASET_LAYOUTS = ("npz", "kitti", "nuscenes")
VIEWS = ("mean", "max", "min")  # how three occupancies become the P of Eq. 11
THE_LIDAR = "LiDAR"  # name of the one of a scene whose [sensor] and [deployment] say it
SIDES = ("right", "left", "median", "gantry")  # of a road, seen in the direction of travel, on which a mast stands
READINGS = ("corrected", "paper")
SEARCHES = ("hardened", "de-pso", "grid", "random")  # the first unless said
METRIC_NAMES = ("pe-vgop", "detectable", "view-coverage")  # the first unless said

DEFAULT_CELL_M = 0.05  # side of an occupancy cell, the paper's mu
PARTICLES, ITERATIONS = 20, 100  # the paper's N and T, section V.A
MOST_RANGE_NOISE_M = 10.0
STATED_RANGE_LIMITS_M = (0.01, 1e5)  # of a target of 10 % reflectivity
MOST_SPREAD_DEG = 5.0  # between the beams of a model's units
