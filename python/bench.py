"""What it costs to turn the records of a minute into frames, beside the work of the recorder that made them."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
import pandas  # noqa: F401  (its import is no conversion)

import seabearing as sb

if __name__ == "__main__":
    scenario = Path(__file__).parents[1] / "scenarios" / "short-pass.toml"
    with tempfile.TemporaryDirectory() as folder:
        written = sb.simulate(scenario, folder)
        recording = sb.read(written["recording"], station=written["station"][0])
        minute = np.tile(recording.codes, (12, 1))
        begun = time.process_time()
        run = sb.process(minute, rate_hz=recording.rate_hz, start=recording.start, station=written["station"][0])
        processed = time.process_time()
        frames = {kind: run.frame(kind) for kind in run.counts}
        converted = time.process_time()
    work, conversion = processed - begun, converted - processed
    print(f"recorder {work:.3f} s, frames {conversion:.4f} s: {conversion / (work + conversion):.1%} of the time (bar 5 %)")
