"""Transformation grids for tests, in the NTv2 format of the Canadian survey, which PROJ recognises by its content."""

import struct
from pathlib import Path


def write_constant_shift(
    path: Path, *, south_deg: float, north_deg: float, west_deg: float, east_deg: float, shift_s: float
) -> None:
    """A grid that adds ``shift_s`` seconds to every latitude between the limits."""

    def text(key: str, value: str) -> bytes:
        return key.ljust(8).encode() + value.ljust(8).encode()

    def whole(key: str, value: int) -> bytes:
        return key.ljust(8).encode() + struct.pack("<ii", value, 0)

    def number(key: str, value: float) -> bytes:
        return key.ljust(8).encode() + struct.pack("<d", value)

    step_s = 3600.0
    rows, columns = round(north_deg - south_deg) + 1, round(east_deg - west_deg) + 1
    head = [
        whole("NUM_OREC", 11), whole("NUM_SREC", 11), whole("NUM_FILE", 1), text("GS_TYPE", "SECONDS"),
        text("VERSION", "TEST"), text("SYSTEM_F", "DHDN90"), text("SYSTEM_T", "ETRS89"), number("MAJOR_F", 6377397.155),
        number("MINOR_F", 6356078.963), number("MAJOR_T", 6378137.0), number("MINOR_T", 6356752.314),
        text("SUB_NAME", "DHDN90"), text("PARENT", "NONE"), text("CREATED", ""), text("UPDATED", ""),
        number("S_LAT", south_deg * 3600), number("N_LAT", north_deg * 3600), number("E_LONG", -east_deg * 3600),
        number("W_LONG", -west_deg * 3600), number("LAT_INC", step_s), number("LONG_INC", step_s),
        whole("GS_COUNT", rows * columns),
    ]  # fmt: skip
    nodes = struct.pack("<ffff", shift_s, 0.0, 0.0, 0.0) * (rows * columns)
    path.write_bytes(b"".join(head) + nodes + text("END", ""))
