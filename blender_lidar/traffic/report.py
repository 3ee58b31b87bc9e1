"""What reading a recording found and repaired."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from ..errors import printable


@dataclass(frozen=True, slots=True)
class RepairReport:
    """Counts of everything that reading a recording changed.

    Attributes
    ----------
    rows_read : int
        Rows in the file, all locations and periods.
    rows_used : int
        Rows of the file that became boxes.
    location, period : str
        What was read of a file that mixes several; empty where the file names none.
    locations, periods : tuple of str
        What the file holds.
    duplicates : int
        Rows dropped because they repeat another in every value that is used.
    repeated : int
        Rows dropped because their vehicle was already there in that frame, elsewhere or with another size.
    off_map : int
        Rows dropped because they lie kilometres from the section, or have no place at all.
    left_out : int
        Rows of what is no vehicle on a road: persons, containers, trains.
    interpolated : int
        Boxes added in gaps of at most 0.5 s.
    tracks_split : int
        Longer gaps, over which no heading is smoothed.
    sizes_repaired : int
        Vehicles whose size was missing or absurd.
    headings_held, headings_clamped : int
        Boxes whose heading was kept from before, being slow or alone; or limited, being too far off the road's.
    overlaps, overlap_frames : int
        Pairs of overlapping boxes, and the number of frames looked at.
    notes : tuple of str
        Choices made for want of a setting, as sentences.
    """

    rows_read: int = 0
    rows_used: int = 0
    location: str = ""
    period: str = ""
    locations: tuple[str, ...] = ()
    periods: tuple[str, ...] = ()
    duplicates: int = 0
    repeated: int = 0
    off_map: int = 0
    left_out: int = 0
    interpolated: int = 0
    tracks_split: int = 0
    sizes_repaired: int = 0
    headings_held: int = 0
    headings_clamped: int = 0
    overlaps: int = 0
    overlap_frames: int = 0
    notes: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """A few lines for a person: only what happened; names from the file are made printable."""
        happened = [
            (self.duplicates, "duplicate row", "dropped"),
            (self.repeated, "row", "dropped: vehicle already in that frame"),
            (self.off_map, "row", "dropped: off the map"),
            (self.left_out, "row", "left out: no vehicle on a road"),
            (self.interpolated, "box", "interpolated in gaps of at most 0.5 s"),
            (self.tracks_split, "longer gap", "left open"),
            (self.sizes_repaired, "vehicle", "with a missing or absurd size repaired"),
            (self.headings_held, "heading", "held (slower than 2 m/s, or no neighbour in time)"),
            (self.headings_clamped, "heading", "limited"),
        ]
        lines = [f"{self.rows_used:,} of {_counted(self.rows_read, 'row')} used{self._chosen()}"]
        lines += [f"{_counted(count, noun)} {outcome}" for count, noun, outcome in happened if count]
        if self.overlaps:
            pairs, frames = _counted(self.overlaps, "pair"), _counted(self.overlap_frames, "frame")
            lines.append(f"{pairs} of overlapping boxes in {frames} looked at")
        return [printable(line) for line in (*lines, *self.notes)]

    def as_dict(self) -> dict[str, object]:
        """All counts, for a result file."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    def _chosen(self) -> str:
        chosen = [
            f"{what} {value}"
            for what, value, several in (
                ("location", self.location, len(self.locations) > 1),
                ("period", self.period, len(self.periods) > 1),
            )
            if value and several
        ]
        return f" ({', '.join(chosen)})" if chosen else ""


def _counted(count: int, noun: str) -> str:
    plural = "es" if noun.endswith("x") else "s"
    return f"{count:,} {noun}{plural if count != 1 else ''}"
