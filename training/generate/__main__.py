"""`python -m training.generate OUT`: pictures with drawn defects, as COCO."""

from __future__ import annotations

import argparse
from pathlib import Path

from training.generate.folder import write_pictures


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(
        prog="python -m training.generate", description="Draw defects on real and painted walls."
    )
    parser.add_argument("out", type=Path, help="folder for images/ and coco.json")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="holds defects/ and drone/")
    parser.add_argument("--count", type=int, default=6000)
    parser.add_argument("--seed", type=int, default=0, help="number of the first picture")
    parser.add_argument("--side", type=int, default=416, help="pixels")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    print(
        write_pictures(
            given.data, given.out, count=given.count, seed=given.seed, side_px=given.side, workers=given.workers
        )
    )


if __name__ == "__main__":
    main()
