"""Samples of a recording."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from . import _native

if TYPE_CHECKING:
    import numpy.typing as npt


class Recording:
    """Four channels at the recorder's rate, without gaps."""

    def __init__(self, native: _native.Samples) -> None:
        #: Samples a second.
        self.rate_hz: float = native.rate_hz
        #: The station's name.
        self.station: str = native.station
        #: Code that means clipping.
        self.full_scale: int = native.full_scale
        #: UTC of the first sample (``datetime64[ns]``); ``None`` where it is not known.
        self.start: np.datetime64 | None = _utc(native.start)
        #: Codes, shape (n, 4), ``int32``; ``MISSING`` where there is none.
        self.codes: npt.NDArray[np.int32] = np.frombuffer(native.codes(), dtype=np.int32).reshape(-1, 4)

    #: Code of a sample that is missing.
    MISSING = _native.Samples.MISSING

    def __len__(self) -> int:
        return len(self.codes)

    def __repr__(self) -> str:
        begun = "at an unknown time" if self.start is None else f"from {self.start}Z on"
        return f"<Recording of {self.station}: {len(self) / self.rate_hz:.3f} s at {self.rate_hz:g} Hz {begun}>"

    @cached_property
    def samples(self) -> npt.NDArray[np.float64]:
        """Parts of full scale, shape (n, 4); NaN where a sample is missing."""
        samples = self.codes / float(2**23)
        samples[self.codes == self.MISSING] = np.nan
        return samples

    @cached_property
    def t_s(self) -> npt.NDArray[np.float64]:
        """Seconds from the first sample, shape (n,)."""
        return np.arange(len(self)) / self.rate_hz


def _utc(text: str | None) -> np.datetime64 | None:
    return None if text is None else np.datetime64(text.removesuffix("Z"), "ns")
