"""Which frame an instant of SUMO's floating car data is: times are in the files, numbers are not."""

from __future__ import annotations

import numpy as np

_COARSEST_ROUNDING_MS = 10  # SUMO writes two digits by default
_ROUNDING_WITHIN = 0.4  # of a step, so that neighbouring instants stay apart
_FEWEST_STEPS = 4  # from which on a rhythm can be told from chance


def frames_of(time_ms: np.ndarray) -> tuple[np.ndarray, float, list[str]]:
    """Frame numbers, and the time from one to the next.

    The step is the longest of which all differences between instants are multiples, if two instants are that close.
    Times that were rounded when they were written, such as 0.00, 0.33, 0.67, 1.00, have no such step: theirs is the
    mean one, if counting it meets every instant within the rounding. Else they are uneven.

    Parameters
    ----------
    time_ms : ndarray, (n,) int64

    Returns
    -------
    frame : ndarray, (n,) int64
        Different for different times, and ascending with them; 0 is about time 0.
    step_s : float
        That of an only instant is the longest of which both it and a second are multiples.
    notes : list of str
        What is doubtful about them, as sentences.
    """
    distinct, of_row = np.unique(time_ms, return_inverse=True)
    if len(distinct) == 1:
        step = int(np.gcd(distinct[0], 1000))
        return time_ms // step, step / 1000, []
    apart = np.diff(distinct)
    common = int(np.gcd.reduce(apart))
    if common == apart.min():
        return time_ms // common, common / 1000, []
    digit = int(np.gcd.reduce(distinct))
    rounded = _rounded(distinct, digit)
    if rounded is not None:
        frame, step = rounded
        return (
            frame[of_row],
            step / 1000,
            [f"times are rounded to {digit / 1000:g} s: a time step of {step / 1000:.4g} s"],
        )
    least, usual, most = (value / 1000 for value in (apart.min(), np.median(apart), apart.max()))
    uneven = (
        f"times are {least:g} to {most:g} s apart, {usual:g} s in the median: frames count steps of {common / 1000:g} s"
    )
    return time_ms // common, common / 1000, [uneven]


def _rounded(distinct: np.ndarray, digit: int) -> tuple[np.ndarray, float] | None:
    """Frame number of every instant and the step [ms], if the instants are multiples of a step rounded to `digit`."""
    apart = np.diff(distinct)
    if digit > _COARSEST_ROUNDING_MS or len(apart) < _FEWEST_STEPS:
        return None
    usual = np.sort(apart)[len(apart) // 2]
    step = apart[np.abs(apart - usual) <= digit].mean()
    if digit > _ROUNDING_WITHIN * step:
        return None
    count = np.concatenate([[0], np.cumsum(np.rint(apart / step).astype(np.int64))])
    if (np.diff(count) < 1).any():
        return None
    step = (distinct[-1] - distinct[0]) / count[-1]
    if (np.abs(distinct - distinct[0] - step * count) > digit).any():
        return None
    return count + int(np.rint(distinct[0] / step)), float(step)
