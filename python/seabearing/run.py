"""What the recorder says of a recording."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from .recording import _utc

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas
    import polars


@dataclass(frozen=True)
class Spectra:
    """Spectra of the intervals whose levels were measured."""

    #: Beginnings of the intervals, s from the first sample, shape (t,).
    t_s: npt.NDArray[np.float64]
    #: The same in UTC (``datetime64[ns]``), NaT where it is not known, shape (t,).
    utc: npt.NDArray[np.datetime64]
    #: Recorder channels, from 0.
    channels: list[int]
    #: Middles of the cells, Hz, shape (f,).
    frequency_hz: npt.NDArray[np.float64]
    #: Spectral densities, dB re reference² in a hertz, shape (t, channels, f); NaN where nothing was measured.
    density_db: npt.NDArray[np.float64]
    #: What they are of, for each channel: ``1 µPa``, ``1 nm/s`` or ``full scale``.
    reference: list[str]


class Run:
    """The records of a recorder that has heard a recording."""

    def __init__(self, native: _native.Run) -> None:
        self._native = native
        #: The station's name.
        self.station: str = native.station
        #: UTC of sample 0 (``datetime64[ns]``); ``None`` where the recording does not tell it.
        self.start: np.datetime64 | None = _utc(native.start)
        #: Seconds of data, and the processor time they took.
        self.data_s: float = native.data_s
        self.processor_s: float = native.processor_s

    @property
    def counts(self) -> dict[str, int]:
        """How many records there are of each type."""
        return self._native.counts()

    def __repr__(self) -> str:
        counts = ", ".join(f"{n} {kind}" for kind, n in self.counts.items())
        return f"<Run of {self.station}: {self.data_s:.1f} s; {counts}>"

    def records(self, kind: str | None = None) -> list[dict[str, Any]]:
        """The records of a type (all where none is said), as the command prints them."""
        return self._native.records(kind)

    def columns(self, kind: str) -> dict[str, npt.NDArray[Any]]:
        """The records of a type as NumPy arrays by field: numbers as they are with NaN for null, times as ``datetime64``."""
        return {name: _column(name, values) for name, values in self._native.columns(kind).items()}

    def frame(self, kind: str) -> pandas.DataFrame:
        """The records of a type as a pandas frame; ``utc`` columns are times with their zone."""
        import pandas

        frame = pandas.DataFrame(self.columns(kind))
        for name in frame.columns:
            if _is_utc(name):
                frame[name] = frame[name].dt.tz_localize("UTC")
        return frame

    def polars(self, kind: str) -> polars.DataFrame:
        """The records of a type as a Polars frame; ``utc`` columns are times with their zone."""
        import polars

        frame = polars.DataFrame(self._native.columns(kind), strict=False, infer_schema_length=None)
        times = [name for name in frame.columns if _is_utc(name)]
        if not times:
            return frame
        return frame.with_columns(polars.col(times).str.to_datetime(time_unit="ns", time_zone="UTC"))

    def spectra(self) -> Spectra:
        """The spectra of the levels; needs ``process(..., levels=SECONDS)``.

        Raises:
            SeabearingError: No levels were measured.
        """
        records = self._native.records("level")
        if not records:
            raise _native.SeabearingError("no levels were measured: process(..., levels=60) measures them each minute")
        begun = sorted({record["t_s"] for record in records})
        channels = sorted({record["channel"] for record in records})
        frequency = sorted({hz for record in records for hz in record["psd_hz"]})
        density = np.full((len(begun), len(channels), len(frequency)), np.nan)
        reference = [""] * len(channels)
        utc = np.full(len(begun), np.datetime64("NaT", "ns"))
        for record in records:
            t, channel = bisect_left(begun, record["t_s"]), bisect_left(channels, record["channel"])
            reference[channel] = record["reference"]
            if record.get("utc") is not None:
                utc[t] = _utc(record["utc"])
            cells = np.searchsorted(frequency, record["psd_hz"])
            density[t, channel, cells] = np.array(record["psd_db"], dtype=np.float64)
        return Spectra(np.array(begun), utc, channels, np.array(frequency), density, reference)

    def to_jsonl(self, path: str | PathLike[str]) -> None:
        """Writes all records as JSON Lines, byte for byte what ``seabearing process`` prints."""
        Path(path).write_text(self._native.jsonl(), encoding="utf-8")


def _is_utc(name: str) -> bool:
    return name == "utc" or name.startswith("utc_")


def _column(name: str, values: list[Any]) -> npt.NDArray[Any]:
    """An array of the type that the values have: times, numbers (null is NaN), or else objects."""
    if _is_utc(name):
        return np.array(["NaT" if v is None else v.removesuffix("Z") for v in values], dtype="datetime64[ns]")
    if all(isinstance(v, bool) for v in values):
        return np.array(values, dtype=bool)
    if all(isinstance(v, int) and not isinstance(v, bool) for v in values):
        return np.array(values, dtype=np.int64 if max(values, default=0) < 2**63 else np.uint64)
    if all(v is None or (isinstance(v, (int, float)) and not isinstance(v, bool)) for v in values):
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
