"""What is usual: all numbers by which the plausibility of traffic and mountings is judged, each with its reason.

Limits lie beyond what real recordings (NGSIM) and generated ones (SUMO) have, which the tests read.
"""

from __future__ import annotations

import math

from ..traffic.ngsim import FOOT_M

# --- How much of it
FEWEST = 20  # boxes or moves: of fewer a share is known to no better than a fifth
FEWEST_TOGETHER = 5  # vehicles: what so many do at one time is no accident of one
SAMPLE, TRACK_ROWS = 20_000, 100_000  # boxes, and rows of whole tracks, that are looked at: a second at most
FEW, SOME, MANY = 0.02, 0.05, 0.2  # shares: measurement errors; what is worth a note; what is worth a stop
MINORITY, HALF, MOST, ALL = 0.4, 0.5, 0.8, 0.95  # under a half; a half; what a guess must set right; except for errors

# --- Sizes [m]: least and largest length, width and height, from children to road trains, with room for measurement
SIZES_M = {
    "car": ((2.6, 8.0), (1.1, 2.8), (0.9, 2.8)),
    "van": ((2.5, 20.0), (1.1, 3.0), (1.0, 4.5)),
    "truck": ((3.0, 40.0), (1.3, 3.1), (1.2, 5.0)),
    "bus": ((5.0, 60.0), (1.5, 3.1), (1.8, 5.0)),
    "motorcycle": ((0.8, 4.0), (0.25, 2.0), (0.6, 2.6)),
    "bicycle": ((0.8, 4.0), (0.25, 2.0), (0.6, 2.6)),
    "pedestrian": ((0.1, 2.0), (0.1, 2.0), (0.6, 2.6)),
}
UNITS = {"feet": FOOT_M, "centimetres": 0.01, "millimetres": 0.001}  # what sizes may be in for metres
LONG_M, HIGHER_M = 7.0, 0.2  # trucks and buses this long are higher than cars by more than this
ALIKE_M = 0.05  # sizes that differ by less are one number
OFF_MIDDLE_M = 0.5  # of a box above its half height: more than kerbs, lorries' axles and survey errors
OVERLAPPING = 0.12  # pairs a box: unrelated labels reach 0.1; a fifth of the vehicles there twice make 0.16
SAME_PLACE_M = 0.5  # between the middles of two boxes: no two vehicles are so near
ON_PLANE_M = 0.05  # of a floor off z = 0: boxes that are surveyed are farther off, others stand on it
LENGTH_VARIES = 0.05  # of itself, along one track: trackers that fit a box in each frame

# --- Motion
MOVED_M, MOST_ROWS_APART = 5.0, 64  # so far that noise of 0.5 m turns a direction by 8 degrees; rows of a track
CRAWL_M_S, CRAWL_S = 1.5, 60.0  # nine of ten that move are slower for longer than this: no traffic
FASTEST_MEDIAN_M_S, FASTEST_M_S = 44.0, 70.0  # 160 km/h for the traffic, 250 for any vehicle
STANDS_M_S = 0.5
JUMP_M = 20.0  # in one row: beyond any error of position
ASIDE_M, AHEAD_M = 1.5, 5.0  # that all jump together: under half a lane; 5 m in 1 s, twice what brakes do
TOGETHER_S = 2.0  # between rows, at most, for that
AGAIN_S = 3.0  # who jumps back within this was no vehicle that left and came again
ASTRAY_RAD = math.radians(30.0)  # of a heading off the motion: no vehicle drifts so
OFF_RAD = math.radians(3.0)  # of headings off the motion, place by place: real and generated ones are up to 1.5
TURN_DEG = 3.0  # from row to row in the median: real and generated ones are under 1
PLACE_M = 20.0  # a place: within it no street bends by much

# --- Road
ALONG_RAD = math.radians(5.0)  # who drives along a road, for the direction of the road
DRIFT_RAD = (math.radians(1.5), math.radians(15.0))  # that crosses half a lane in 60 m; lane changes are beyond
OFF_LANE_M, ABOUT_LANE_M = 1.0, 0.7  # from a lane's middle: nobody drives so, and nearly all drive so
WIDER = 0.08  # of a lane's width: a map's scale is right to 2 %, feet or a projection are further off

DRIFTED_M = 1.0  # of all lanes across the road: lanes are marked, and vehicles' places in them vary by less together
DRIFT_WINDOWS, DRIFT_WINDOW_S = 8, (7.5, 15.0)  # in a short recording; their lengths, in which 10 cm/s stay in a lane
DRIFT_ERRORS = 4.0  # standard errors: none of 24 recordings without drift has as many
COUPLED_M, COUPLED_FRAMES = 0.5, 100  # off each other end to end, as no two drivers stay; frames that are looked at
SAGITTA_M = 2.0  # of a bend: more than half a lane, and vehicles are in the lane beside
GROUND_M, BESIDE_M = 100.0, 40.0  # along the road and across it: how far the ground is looked at for a grade
GRADE_PERCENT = 1.0  # a metre in a hundred: maps are that good, and it moves a beam's end by a car's height at 150 m
LEVEL_PERCENT = 0.2  # less than what a fit to vehicles of other heights gives by itself

# --- Mounting and sensor
ROUND_DEG, DECIMALS = 5.0, 2  # degrees that people choose; digits that they write radians with
ABREAST_M = 20.0  # what passes this near to a mast has been or will be beside it
HIGHEST_M = 20.0  # gantries and lamps end at 12
NOISE_M = 0.2  # data sheets: 0.01 to 0.05
AWAY = 0.5  # cosine to the opposite direction: what looks down farther than this from it looks away
