"""Vehicle ids in files whose whole numbers are narrower than ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import OutputError


def check_ids_fit(path: str | Path, vehicle_id: np.ndarray, bits: int) -> None:
    """Refuse to write ids that a file of whole numbers with a sign and so many `bits` would change."""
    limit = 2 ** (bits - 1)
    wide = vehicle_id[(vehicle_id >= limit) | (vehicle_id < -limit)]
    if len(wide):
        raise OutputError(
            f"{path}: vehicle_id {wide[0]} does not fit into the {bits} bits of a "
            f"{Path(path).suffix.lstrip('.').upper()} file; .npz keeps it"
        )
