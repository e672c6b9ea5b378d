"""Measure whole inspections: time and memory of each stage, the second run, and the figures against truth.

    .venv/bin/python -m benchmarks.foundation castle demo

Each building is inspected into a fresh lake by the command line, as a user would; the castle with and without control
points and with exact and noisy boxes. Prints Markdown. Takes about 10 minutes on 2 cores.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parent.parent
CLI = [sys.executable, "-c", "from cli.main import main; main()"]
SHARED = Path(os.environ.get("FACADELAKE_SHARED_DATA", ROOT.parent / "shared" / "data"))
DEMO = Path(os.environ.get("FACADELAKE_DEMO", ROOT / "build" / "demo"))


def facadelake(*words: str) -> tuple[str, float]:
    """Run the command line; its output and wall seconds."""
    begin = time.perf_counter()
    done = subprocess.run([*CLI, *words], cwd=ROOT, capture_output=True, text=True)
    seconds = time.perf_counter() - begin
    if done.returncode:
        raise SystemExit(f"facadelake {' '.join(words)} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout, seconds


def ask(lake: Path, sql: str) -> list[dict[str, Any]]:
    """Rows of a question to the lake."""
    rows: list[dict[str, Any]] = json.loads(facadelake("sql", sql, "--json", "--lake", str(lake))[0])
    return rows


def stages(lake: Path, building: str, campaign: str) -> str:
    """Time and peak memory of each stage, as Markdown."""
    run = ask(lake, f"SELECT * FROM runs WHERE building_id = '{building}' AND campaign_id = '{campaign}'")[0]
    seconds, peaks = json.loads(run["stage_seconds"]), json.loads(run["stage_peak_mib"])
    lines = ["| stage | wall s | peak MiB |", "|---|---|---|"]
    lines += [f"| {name} | {value:.1f} | {peaks[name]} |" for name, value in seconds.items()]
    return "\n".join(lines)


def evaluated(lake: Path, building: str, campaign: str, truth: Path, *more: str) -> dict[str, Any]:
    """The figures of ``facadelake evaluate``."""
    text, _ = facadelake("evaluate", building, campaign, "--truth", str(truth), "--json", "--lake", str(lake), *more)
    figures: dict[str, Any] = json.loads(text)
    return figures


def line(name: str, figures: dict[str, Any]) -> str:
    """One row of the table of figures."""

    def cm(stats: dict[str, Any] | None, key: str) -> str:
        return "" if stats is None else f"{stats[key] * 100:.1f}"

    merge = figures["merge"]
    cells = [
        name,
        f"{figures['photographs']['localised']}/{figures['photographs']['total']}",
        cm(figures["camera_error_m"], "mean"),
        " / ".join(cm(figures["camera_error_m"], f"offset_{axis}") for axis in ("east", "north", "up")),
        f"{figures['coverage_2sigma']:.2f}",
        cm(figures["ray_error_m"], "mean"),
        f"{cm(figures['observation_error_m'], 'mean')} / {cm(figures['observation_error_m'], 'median')}",
        f"{cm(figures['defect_error_m'], 'mae')} / {cm(figures['defect_error_m'], 'p95')}",
        f"{merge['precision']:.3f} / {merge['recall']:.3f} / {merge['f1']:.3f}",
        f"{figures['element_correct_share']:.3f}",
        str(figures["off_truth"]),
    ]
    return "| " + " | ".join(cells) + " |"


HEADER = (
    "| run | localised | camera mean cm | offset e / n / u cm | inside 2 sigma | ray mean cm | "
    "observation mean / median cm | defect MAE / p95 cm | merge P / R / F1 | element right | off truth |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def castle(lakes: Path) -> None:
    """The castle with each control, exact and noisy boxes."""
    truth = SHARED / "castle" / "truth"
    rows = []
    for control in ("gcp", "gps", "model"):
        lake = lakes / f"castle-{control}"
        if (lakes / "castle-gcp" / "cache").is_dir() and control != "gcp":
            lake.mkdir()
            (lake / "cache").symlink_to(lakes / "castle-gcp" / "cache")  # the reconstruction is the same for all
        words = ("inspect", "castle", "2026-04", "--georeference", control, "--lake", str(lake))
        _, first = facadelake(*words)
        if control == "gcp":
            _, second = facadelake(*words)
            print(f"\n### castle: first run {first:.0f} s, second run {second:.0f} s\n")
            print(stages(lake, "castle", "2026-04"))
        rows.append(line(f"castle, {control}, exact boxes", evaluated(lake, "castle", "2026-04", truth)))
        if control == "gcp":
            noisy = evaluated(lake, "castle", "2026-04", truth, "--detections", "noisy")
            rows.append(line("castle, gcp, noisy boxes", noisy))
    print(f"\n{HEADER}\n" + "\n".join(rows))


def demo(lakes: Path) -> None:
    """The demo building's two campaigns by what ``auto`` chooses, and the first by its model alone."""
    lake = lakes / "demo"
    _, first = facadelake("demo", "--lake", str(lake))
    _, second = facadelake("demo", "--lake", str(lake))
    print(f"\n### demo: first run {first:.0f} s, second run {second:.0f} s\n")
    print(stages(lake, "demo", "2026-04"))
    rows = []
    for campaign in ("2026-04", "2026-10"):
        truth = DEMO / "campaigns" / campaign / "truth"
        rows.append(line(f"demo {campaign}, exact boxes", evaluated(lake, "demo", campaign, truth)))
        noisy = evaluated(lake, "demo", campaign, truth, "--detections", "noisy")
        rows.append(line(f"demo {campaign}, noisy boxes", noisy))
    alone = lakes / "demo-model"
    alone.mkdir()
    (alone / "cache").symlink_to(lake / "cache")
    facadelake("inspect", "demo", "2026-04", "--georeference", "model", "--lake", str(alone))
    truth = DEMO / "campaigns" / "2026-04" / "truth"
    rows.append(line("demo 2026-04, model, exact boxes", evaluated(alone, "demo", "2026-04", truth)))
    print(f"\n{HEADER}\n" + "\n".join(rows))


def main() -> None:
    """Run what is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("buildings", nargs="+", choices=["castle", "demo"])
    arguments = parser.parse_args()
    memory = psutil.virtual_memory().total / 2**30
    print(
        f"{datetime.now(UTC):%Y-%m-%d}, {psutil.cpu_count()} cores, {memory:.0f} GiB, "
        f"Python {platform.python_version()}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for building in arguments.buildings:
            {"castle": castle, "demo": demo}[building](Path(folder))


if __name__ == "__main__":
    main()
