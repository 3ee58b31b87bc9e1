"""A metric of one's own: how much of each vehicle's worst seen view the beams hit.

From the command line, in this folder:

    blender-lidar optimise i80 --metric own_metric.py:worst_view
"""

import blender_lidar as bl


@bl.metric(tells="what share of its least seen view the beams hit")
def worst_view(returns):
    """Smallest of the three occupancies, (n,), of n vehicles."""
    return returns.occupancy.min(axis=1)


if __name__ == "__main__":  # workers load this file too, and must not search
    site = bl.load_scene("i80", metric=worst_view, frames=4, particles=5, iterations=8)
    run = bl.best_mounting(site, progress=True)
    print(run)

    # What does the paper's metric make of that mounting, and of its own choice?
    of_paper = bl.load_scene("i80", frames=4, particles=5, iterations=8)
    print(bl.score_mountings(of_paper, [run.mounting, bl.best_mounting(of_paper).mounting]))
