"""What users hand over becomes codes of a 24-bit converter."""

from __future__ import annotations

import numpy as np

from seabearing.inputs import codes


def test_samples_of_half_precision_are_the_same_codes() -> None:
    half = np.array([[0.5, -0.25, np.nan, 0.001], [1.0, -1.0, np.inf, 0.0]], dtype=np.float16)
    assert (codes(half) == codes(half.astype(np.float64))).all()
