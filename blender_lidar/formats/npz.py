"""NPZ files of points, read without trusting what they say of their own size."""

from __future__ import annotations

import math
import os
import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import InputError
from ..input_file import MOST_TIMES_UNPACKED, most_unpacked, open_file

_SUFFIX = ".npy"
_READ_HEADER = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_FLOAT_BYTES = 8  # what each number takes once it is read


def read_npz(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The array `xyz` as floats, and `vehicle_id` as the file has it, None where it has none.

    Raises
    ------
    InputError
        If the file is damaged, has no `xyz` of real numbers, or an array that it cannot hold.
    OSError
        If it cannot be read.
    """
    with open_file(path) as stream:
        most = most_unpacked(os.fstat(stream.fileno()).st_size)
        try:
            with zipfile.ZipFile(stream) as archive:
                names = [name.removesuffix(_SUFFIX) for name in archive.namelist()]
                if "xyz" not in names:
                    raise InputError(f"{path}: has no array 'xyz'; it has {', '.join(names) or 'nothing'}")
                xyz = _array(path, archive, "xyz", most)
                if xyz.dtype.kind not in "iufb":
                    raise InputError(f"{path}: xyz is of type {xyz.dtype}; allowed: numbers")
                ids = _array(path, archive, "vehicle_id", most) if "vehicle_id" in names else None
        except (InputError, OSError):
            raise
        except Exception as error:  # NumPy and zipfile raise many kinds for a damaged file
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"{path}: is not a readable NPZ file ({reason})") from error
    with np.errstate(over="ignore", invalid="ignore"):  # what float64 cannot hold is not finite, and left out
        return xyz.astype(float), ids


def _array(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> np.ndarray:
    """An array of a file that may unpack to `most` bytes: what its header claims is there before memory is taken."""
    member = archive.getinfo(name + _SUFFIX if name + _SUFFIX in archive.NameToInfo else name)
    with archive.open(member) as stream:
        numbers, size = _claimed_numbers(stream)
        left = member.file_size - stream.tell()
    if numbers * size > left:
        raise InputError(f"{path}: {name} takes {numbers * size} bytes, but it has {left}")
    if numbers * max(size, _FLOAT_BYTES) > most:
        raise InputError(f"{path}: {name} unpacks to more than {MOST_TIMES_UNPACKED} times the file's size")
    with archive.open(member) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _claimed_numbers(stream: BinaryIO) -> tuple[int, int]:
    """How many numbers the header of an array promises, and the bytes of each."""
    version = np.lib.format.read_magic(stream)
    if version not in _READ_HEADER:  # the third is for names of fields that are not Latin
        raise ValueError(f"an array in version {version[0]}.{version[1]} of the format")
    shape, _, dtype = _READ_HEADER[version](stream)
    return math.prod(shape), dtype.itemsize
