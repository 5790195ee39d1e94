from collections.abc import Callable
from os import PathLike
from typing import Any, TypedDict

class SeabearingError(ValueError): ...

class Asked(TypedDict):
    station: str | PathLike[str]
    propagation: str | PathLike[str] | None
    files: list[str | PathLike[str]]
    codes: tuple[bytes, float] | None
    start: str | None
    from_time: str | None
    to_time: str | None
    name_offset: str | None

class Samples:
    MISSING: int
    rate_hz: float
    start: str | None
    full_scale: int
    station: str
    def codes(self) -> bytes: ...

class Run:
    station: str
    start: str | None
    data_s: float
    processor_s: float
    def counts(self) -> dict[str, int]: ...
    def records(self, kind: str | None = None) -> list[dict[str, Any]]: ...
    def columns(self, kind: str) -> dict[str, list[Any]]: ...
    def jsonl(self) -> str: ...

def read(input: Asked, progress: Callable[[float], object] | None) -> Samples: ...
def process(input: Asked, levels_s: float | None, progress: Callable[[float], object] | None) -> Run: ...
def simulate(
    scenario: str | PathLike[str], out: str | PathLike[str]
) -> list[tuple[str, str]]: ...
def propagation_table(
    profile: str | PathLike[str], depth_m: float, rows: int, out: str | PathLike[str]
) -> None: ...
