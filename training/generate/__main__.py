"""`python -m training.generate OUT`: pictures with generated defects, as COCO."""

from __future__ import annotations

import argparse
from pathlib import Path

from training.generate.folder import write_pictures


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.generate", description="Generate pictures of defects on real and synthetic walls."
    )
    parser.add_argument("out", type=Path, help="folder for images/ and coco.json")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with defects/ and drone/")
    parser.add_argument("--count", type=int, default=6000, help="number of pictures")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first picture")
    parser.add_argument("--side", type=int, default=416, help="width and height in pixels")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    options = parser.parse_args()
    print(
        write_pictures(
            options.data,
            options.out,
            count=options.count,
            seed=options.seed,
            side_px=options.side,
            workers=options.workers,
        )
    )


if __name__ == "__main__":
    main()
