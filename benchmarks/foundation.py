"""Benchmark of whole inspections: time and memory of each stage, time of a repeated run, and accuracy against truth.

    .venv/bin/python -m benchmarks.foundation castle demo

Each building is inspected by the command line into a new lake; the castle with and without control points and with
exact and noisy boxes. Prints Markdown. Takes about 10 minutes on 2 cores.
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


def run_facadelake(*words: str) -> tuple[str, float]:
    """Run the command line of facadelake; its output and wall seconds."""
    begin = time.perf_counter()
    done = subprocess.run([*CLI, *words], cwd=ROOT, capture_output=True, text=True)
    seconds = time.perf_counter() - begin
    if done.returncode:
        raise SystemExit(f"facadelake {' '.join(words)} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout, seconds


def query_lake(lake: Path, sql: str) -> list[dict[str, Any]]:
    """Rows of a SELECT on the lake."""
    rows: list[dict[str, Any]] = json.loads(run_facadelake("sql", sql, "--json", "--lake", str(lake))[0])
    return rows


def format_stages(lake: Path, building: str, campaign: str) -> str:
    """Markdown table of the time and peak memory of each stage."""
    run = query_lake(lake, f"SELECT * FROM runs WHERE building_id = '{building}' AND campaign_id = '{campaign}'")[0]
    seconds, peaks = json.loads(run["stage_seconds"]), json.loads(run["stage_peak_mib"])
    lines = ["| stage | wall s | peak MiB |", "|---|---|---|"]
    lines += [f"| {name} | {value:.1f} | {peaks[name]} |" for name, value in seconds.items()]
    return "\n".join(lines)


def evaluate_campaign(lake: Path, building: str, campaign: str, truth: Path, *more: str) -> dict[str, Any]:
    """Figures of ``facadelake evaluate``; ``more`` are further arguments."""
    text, _ = run_facadelake(
        "evaluate", building, campaign, "--truth", str(truth), "--json", "--lake", str(lake), *more
    )
    figures: dict[str, Any] = json.loads(text)
    return figures


def format_row(name: str, figures: dict[str, Any]) -> str:
    """One row of the table of figures, named ``name``."""

    def format_cm(stats: dict[str, Any] | None, key: str) -> str:
        return "" if stats is None else f"{stats[key] * 100:.1f}"

    merge = figures["merge"]
    cells = [
        name,
        f"{figures['photographs']['localised']}/{figures['photographs']['total']}",
        format_cm(figures["camera_error_m"], "mean"),
        " / ".join(format_cm(figures["camera_error_m"], f"offset_{axis}") for axis in ("east", "north", "up")),
        f"{figures['coverage_2sigma']:.2f}",
        format_cm(figures["ray_error_m"], "mean"),
        f"{format_cm(figures['observation_error_m'], 'mean')} / {format_cm(figures['observation_error_m'], 'median')}",
        f"{format_cm(figures['defect_error_m'], 'mae')} / {format_cm(figures['defect_error_m'], 'p95')}",
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


def measure_castle(lakes: Path) -> None:
    """Inspect the castle with each kind of control, and print the table for exact and noisy boxes."""
    truth = SHARED / "castle" / "truth"
    rows = []
    for control in ("gcp", "gps", "model"):
        lake = lakes / f"castle-{control}"
        if (lakes / "castle-gcp" / "cache").is_dir() and control != "gcp":
            lake.mkdir()
            (lake / "cache").symlink_to(
                lakes / "castle-gcp" / "cache"
            )  # the reconstruction does not depend on the control
        command = ("inspect", "castle", "2026-04", "--georeference", control, "--lake", str(lake))
        _, first = run_facadelake(*command)
        if control == "gcp":
            _, second = run_facadelake(*command)
            print(f"\n### castle: first run {first:.0f} s, second run {second:.0f} s\n")
            print(format_stages(lake, "castle", "2026-04"))
        rows.append(format_row(f"castle, {control}, exact boxes", evaluate_campaign(lake, "castle", "2026-04", truth)))
        if control == "gcp":
            noisy = evaluate_campaign(lake, "castle", "2026-04", truth, "--detections", "noisy")
            rows.append(format_row("castle, gcp, noisy boxes", noisy))
    print(f"\n{HEADER}\n" + "\n".join(rows))


def measure_demo(lakes: Path) -> None:
    """Inspect all campaigns of the demo building with the control chosen by ``auto``, and 2026-04 by its model."""
    lake = lakes / "demo"
    _, first = run_facadelake("demo", "--lake", str(lake))
    _, second = run_facadelake("demo", "--lake", str(lake))
    print(f"\n### demo: first run {first:.0f} s, second run {second:.0f} s\n")
    print(format_stages(lake, "demo", "2026-04"))
    rows = []
    for campaign in ("2025-04", "2025-10", "2026-04", "2026-10"):
        truth = DEMO / "campaigns" / campaign / "truth"
        rows.append(format_row(f"demo {campaign}, exact boxes", evaluate_campaign(lake, "demo", campaign, truth)))
        noisy = evaluate_campaign(lake, "demo", campaign, truth, "--detections", "noisy")
        rows.append(format_row(f"demo {campaign}, noisy boxes", noisy))
    alone = lakes / "demo-model"
    alone.mkdir()
    (alone / "cache").symlink_to(lake / "cache")
    run_facadelake("inspect", "demo", "2026-04", "--georeference", "model", "--lake", str(alone))
    truth = DEMO / "campaigns" / "2026-04" / "truth"
    rows.append(format_row("demo 2026-04, model, exact boxes", evaluate_campaign(alone, "demo", "2026-04", truth)))
    print(f"\n{HEADER}\n" + "\n".join(rows))


def main() -> None:
    """Measure the buildings on the command line."""
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
            {"castle": measure_castle, "demo": measure_demo}[building](Path(folder))


if __name__ == "__main__":
    main()
