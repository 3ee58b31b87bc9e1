"""What reading a recording found and repaired."""

from __future__ import annotations

from dataclasses import asdict, dataclass


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
        Rows dropped because they lie kilometres from the section.
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
    interpolated: int = 0
    tracks_split: int = 0
    sizes_repaired: int = 0
    headings_held: int = 0
    headings_clamped: int = 0
    overlaps: int = 0
    overlap_frames: int = 0
    notes: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """A few lines for a person: only what happened."""
        happened = [
            (self.duplicates, "duplicate rows dropped"),
            (self.repeated, "rows dropped: their vehicle was already in that frame"),
            (self.off_map, "rows dropped: off the map"),
            (self.interpolated, "boxes interpolated in gaps of at most 0.5 s"),
            (self.tracks_split, "longer gaps left open"),
            (self.sizes_repaired, "vehicles with a missing or absurd size repaired"),
            (self.headings_held, "headings held (slower than 2 m/s, or no neighbour in time)"),
            (self.headings_clamped, "headings limited"),
        ]
        lines = [f"{self.rows_used:,} of {self.rows_read:,} rows used{self._chosen()}"]
        lines += [f"{count:,} {text}" for count, text in happened if count]
        if self.overlaps:
            lines.append(f"{self.overlaps:,} pairs of overlapping boxes in {self.overlap_frames:,} frames looked at")
        return [*lines, *self.notes]

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
