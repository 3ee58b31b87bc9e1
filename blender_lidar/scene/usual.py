"""What is usual: numbers by which the plausibility of traffic and mountings is judged, each with its reason.

Limits of one check alone stand with it in `plausibility.CHECKS`.
"""

from __future__ import annotations

import math

# --- How much of it
FEWEST = 20  # boxes or moves: of fewer a share is known to no better than a fifth
FEWEST_TOGETHER = 5  # vehicles: what so many do at one time is no accident of one
SAMPLE, TRACK_ROWS = 20_000, 100_000  # boxes, and rows of whole tracks, that are looked at: a second at most
FEW, SOME, MANY = 0.02, 0.05, 0.2  # shares: measurement errors; what is worth a note; what is worth a stop
MINORITY, HALF, MOST, ALL = 0.4, 0.5, 0.8, 0.95  # under a half; a half; what a guess must set right; except for errors

# --- Traffic
ON_PLANE_M = 0.05  # of a floor off z = 0: boxes that are surveyed are farther off, others stand on it
MOVED_M, MOST_ROWS_APART = 5.0, 64  # so far that noise of 0.5 m turns a direction by 8 degrees; rows of a track
JUMP_M = 20.0  # in one row: beyond any error of position
ASTRAY_RAD = math.radians(30.0)  # of a heading off the motion: no vehicle drifts so

# --- Mounting and sensor
ROUND_DEG, DECIMALS = 5.0, 2  # degrees that people choose; digits that they write radians with
ABREAST_M = 20.0  # what passes this near to a mast has been or will be beside it
HIGHEST_M = 20.0  # gantries and lamps end at 12
NOISE_M = 0.2  # data sheets: 0.01 to 0.05
AWAY = 0.5  # cosine to the opposite direction: what looks down farther than this from it looks away
