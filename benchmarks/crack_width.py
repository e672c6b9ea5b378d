"""Accuracy of crack measurement: width and length of drawn cracks of known width, by width and wall.

    .venv/bin/python -m benchmarks.crack_width 20
    .venv/bin/python -m benchmarks.crack_width 20 --masks ../shared/data/defects/masonry_crack_240/dataset
    .venv/bin/python -m benchmarks.crack_width 0 --lake build/lake

Each photograph shows one crack, whose width varies by a third; its darkness, the blur of the lens, the noise and the
JPEG quality are random. With ``--masks``: real photographs with cracks masked by hand; the width measured in the
bounding box of the mask is compared with the width of the mask. With ``--lake``: the widths of the inspected demo,
those of one crack in several photographs against one another, and those of defects against the widths that were drawn.
Prints Markdown and saves a plot below ``build/``.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from skimage.morphology import medial_axis

from benchmarks.drawn_cracks import ImageDegradation, draw_crack
from facadelake.deduplication.crack_width import estimate_crack_widths, estimate_unknown_blur
from facadelake.demo.defect_recipe import DemoDefect
from facadelake.demo.recipe import load_recipe
from facadelake.demo.textures.defects import sample_crack_lines, seed_defect
from facadelake.evaluation.campaigns import compare_campaign
from facadelake.lake import read_table
from facadelake.measurement.campaign import estimate_photograph_blur, measure_in_photograph
from facadelake.measurement.crack import CrackMeasurement
from facadelake.registry import read_portfolio
from schemas.vocabulary import CrackWidthOutcome

matplotlib.use("Agg")
import matplotlib.pyplot as plt

WIDTHS_PX = (0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)
BUILD = Path(__file__).resolve().parent.parent / "build"
RECIPE = BUILD.parent / "data" / "demo" / "recipe.yaml"
BOX_COLUMNS = ("box_x_px", "box_y_px", "box_width_px", "box_height_px")


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One crack: true and measured width in pixels, and measured over true length (NaN: no centreline)."""

    wall: str
    nominal_px: float
    true_px: float
    outcome: str
    width_px: float
    sigma_px: float
    limit_px: float
    length_share: float
    seconds: float


def measure_drawn_cracks(count: int, wall: str) -> list[Trial]:
    """Draw and measure ``count`` cracks of each width on ``wall`` (``render`` or ``brick``)."""
    out = []
    for width in WIDTHS_PX:
        for seed in range(count):
            rng = np.random.default_rng([seed, round(100 * width)])
            degradation = ImageDegradation(
                blur_px=rng.uniform(0.45, 0.9), noise=rng.uniform(0.004, 0.02), jpeg=int(rng.integers(85, 96))
            )
            crack = draw_crack(rng, width, wall=wall, degradation=degradation, darkness=rng.uniform(0.65, 0.95))
            begin = time.perf_counter()
            found = measure_crack(crack.image, crack.box_px)
            out.append(
                Trial(
                    wall=wall,
                    nominal_px=width,
                    true_px=crack.mean_px,
                    outcome=str(found.outcome),
                    width_px=found.width.mean_px if found.width else float("nan"),
                    sigma_px=found.width.sigma_px if found.width else float("nan"),
                    limit_px=found.width.limit_px if found.width else float("nan"),
                    length_share=found.length_px / crack.length_px,
                    seconds=time.perf_counter() - begin,
                )
            )
    return out


def measure_crack(image: Any, box: tuple[float, float, float, float], mask: str | None = None) -> CrackMeasurement:
    """Measure the crack in a box (left, top, width, height; px) of a photograph; ``mask`` is its outline as WKT."""
    return measure_in_photograph(
        image, {**dict(zip(BOX_COLUMNS, box, strict=True)), "mask": mask}, estimate_photograph_blur(image)
    )


def format_table(trials: list[Trial]) -> str:
    """Markdown table with a row for each wall and width."""
    lines = [
        "| wall | width px | measured | below limit | no centreline | bias px | scatter px | within 0.3 px "
        "| error / sigma | limit px | true width below limit | length / true |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for wall in dict.fromkeys(trial.wall for trial in trials):
        for width in WIDTHS_PX:
            here = [trial for trial in trials if (trial.wall, trial.nominal_px) == (wall, width)]
            measured = [trial for trial in here if trial.outcome == CrackWidthOutcome.MEASURED]
            below = [trial for trial in here if trial.outcome == CrackWidthOutcome.BELOW_LIMIT]
            error = np.array([trial.width_px - trial.true_px for trial in measured])
            pull = np.array([(trial.width_px - trial.true_px) / trial.sigma_px for trial in measured])
            cells = [wall, f"{width:g}", len(measured), len(below), len(here) - len(measured) - len(below)]
            cells += [f"{error.mean():+.2f}", f"{error.std():.2f}"] if len(measured) else ["", ""]
            cells += (
                [f"{np.mean(np.abs(error) <= 0.3):.0%}", f"{np.sqrt(np.mean(pull**2)):.1f}"] if measured else ["", ""]
            )
            limits = [trial.limit_px for trial in here if np.isfinite(trial.limit_px)]
            cells.append(f"{np.median(limits):.1f}" if limits else "")
            cells.append(f"{np.mean([t.true_px <= t.limit_px for t in below]):.0%}" if below else "")
            lengths = [trial.length_share for trial in here if np.isfinite(trial.length_share)]
            cells.append(f"{np.median(lengths):.2f}" if lengths else "")
            lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def plot(trials: list[Trial], path: Path) -> None:
    """Plot measured widths and their errors over the true widths."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.5), layout="constrained")
    for wall, colour in (("render", "tab:blue"), ("brick", "tab:red")):
        measured = [t for t in trials if t.wall == wall and t.outcome == CrackWidthOutcome.MEASURED]
        below = [t for t in trials if t.wall == wall and t.outcome == CrackWidthOutcome.BELOW_LIMIT]
        true, width = (np.array([getattr(t, name) for t in measured]) for name in ("true_px", "width_px"))
        left.errorbar(
            true, width, [t.sigma_px for t in measured], fmt=".", color=colour, lw=0.5, label=f"{wall}: measured"
        )
        left.plot(
            [t.true_px for t in below], [t.limit_px for t in below], "v", mfc="none", color=colour, ms=5,
            label=f"{wall}: upper limit",
        )  # fmt: skip
        right.plot(true, width - true, ".", color=colour, label=wall)
    left.plot([0.4, 14], [0.4, 14], "k", lw=0.7)
    left.set(xscale="log", yscale="log", xlabel="true mean width, px", ylabel="measured, px")
    right.axhspan(-0.3, 0.3, color="0.9")
    right.axhline(0, color="k", lw=0.7)
    right.set(xscale="log", ylim=(-2, 2), xlabel="true mean width, px", ylabel="measured - true, px (grey: goal)")
    left.legend()
    right.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def compare_with_masks(folder: Path, most: int | None) -> str:
    """Compare widths measured in the boxes of masked cracks with the widths of the masks; ``most``: first pairs."""
    pairs = [(image, mask) for image, mask in list_mask_pairs(folder)][:most]
    rows, none = [], 0
    for image_path, mask_path in pairs:
        image, mask = cv2.imread(str(image_path)), cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE)
        _, parts, stats, _ = cv2.connectedComponentsWithStats((mask > 127).astype(np.uint8), connectivity=8)
        if len(stats) < 2:
            continue
        part = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        left, top, wide, high, area = (float(value) for value in stats[part])
        skeleton, distance = medial_axis(parts == part, return_distance=True)
        found = measure_crack(image, (left, top, wide, high))
        if found.width is None:
            none += 1
            continue
        reach = max(wide, high)
        rows.append((found, 2 * float(np.mean(distance[skeleton])), area, reach))
    measured = [
        (found.width.mean_px, width) for found, width, *_ in rows if found.outcome == CrackWidthOutcome.MEASURED
    ]
    width, of_mask = np.array(measured).T
    spans = np.array([found.length_px / reach for found, *_, reach in rows])
    return (
        f"{len(pairs)} masked cracks (the largest of each photograph): {len(measured)} measured, "
        f"{len(rows) - len(measured)} below the limit, {none} without a centreline. Measured minus mask width: median "
        f"{np.median(width - of_mask):+.2f} px, quartiles {np.percentile(width - of_mask, 25):+.2f} and "
        f"{np.percentile(width - of_mask, 75):+.2f} px; "
        f"mask width: median {np.median(of_mask):.1f} px. Length over the longer side of the box: median "
        f"{np.median(spans):.2f}, quartiles {np.percentile(spans, 25):.2f} and {np.percentile(spans, 75):.2f}."
    )


def list_mask_pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Photographs and masks of one file name in ``*_images`` and ``*_masks`` below ``folder``."""
    masks = {path.name: path for path in sorted(folder.rglob("*.png")) if "mask" in path.parent.name}
    pictures = [path for path in sorted(folder.rglob("*.png")) if "image" in path.parent.name]
    return [(path, masks[path.name]) for path in pictures if path.name in masks]


def compare_in_lake(lake: Path, portfolio: Path) -> str:
    """Markdown table of the demo's crack widths by campaign: repeated measurements, and defects against truth."""
    building = read_portfolio(portfolio).get_building("demo")
    drawn_mm = {
        defect.id: 1000 * compute_drawn_width_m(defect)
        for defect in load_recipe(RECIPE).defects
        if defect.kind == "crack"
    }
    lines = [
        "| campaign | unknown blur px | pairs of measurements | inside 2 sigma, stated / with the blur | rms in "
        "sigmas, stated / with the blur | defects | inside 2 sigma of truth, stated / with the blur | measured over "
        "drawn |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for campaign in list_campaigns(lake, building.id):
        table = read_table(lake, "observations", building_id=building.id, campaign_id=campaign)
        rows = table.filter(pc.and_(pc.is_valid(table["defect_id"]), pc.equal(table["defect_class"], "crack")))
        names, group = np.unique(rows["defect_id"].to_pylist(), return_inverse=True)
        width, sigma, gsd = (
            np.array(rows[name].to_pylist(), dtype=np.float64)
            for name in ("crack_width_mm", "crack_width_sigma_mm", "gsd_mm")
        )
        used = np.flatnonzero(np.isfinite(sigma))
        blur_px = estimate_unknown_blur(group[used], width[used], sigma[used], gsd[used])
        sigmas = sigma, np.hypot(sigma, blur_px * gsd)
        pairs = [(i, j) for i in used for j in used if i < j and group[i] == group[j]]
        first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        repeat = [(width[first] - width[second]) / np.hypot(one[first], one[second]) for one in sigmas]
        found = estimate_crack_widths(rows, group, np.ones(len(rows)), len(names))
        # Without the sizes of pixels there is no unknown blur: the errors as measured.
        one_size = pa.array(np.ones(len(rows)), pa.float64())
        plain = rows.set_column(rows.schema.get_field_index("gsd_mm"), rows.schema.field("gsd_mm"), one_size)
        stated = estimate_crack_widths(plain, group, np.ones(len(rows)), len(names))
        compared = compare_campaign(
            building, campaign, lake=lake, truth=building.locate_photographs(campaign).parent / "truth", detections=None
        )
        defects = read_table(lake, "defects", building_id=building.id, campaign_id=campaign)["defect_id"].to_pylist()
        point = dict(zip(defects, compared.check_point_by_defect, strict=True))
        known = [k for k, name in enumerate(names) if point.get(name) in drawn_mm and np.isfinite(found.sigma_mm[k])]
        true = np.array([drawn_mm[point[names[k]]] for k in known])
        error = found.width_mm[known] - true
        cells = [campaign, f"{blur_px:.1f}", len(pairs)]
        cells += [" / ".join(f"{np.mean(np.abs(z) <= 2):.2f}" for z in repeat)]
        cells += [" / ".join(f"{np.sqrt(np.mean(z**2)):.1f}" for z in repeat), len(known)]
        cells += [" / ".join(f"{np.mean(np.abs(error) <= 2 * one.sigma_mm[known]):.2f}" for one in (stated, found))]
        cells.append(f"{np.median(found.width_mm[known] / true):.1f}")
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def compute_drawn_width_m(defect: DemoDefect) -> float:
    """Mean width of a crack's trunk as drawn, without its soft rim, metres."""
    trunk, widths_m = sample_crack_lines(seed_defect(defect.id), defect.width_m, defect.height_m)[0]
    return float(np.average(widths_m, weights=np.linalg.norm(np.diff(trunk, axis=0), axis=1)))


def list_campaigns(lake: Path, building_id: str) -> list[str]:
    """Campaigns of a building in a lake."""
    return sorted(set(read_table(lake, "campaigns", building_id=building_id)["campaign_id"].to_pylist()))


def main() -> None:
    """Run the command line: print the tables and save the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cracks", type=int, nargs="?", default=10, help="cracks of each width and wall")
    parser.add_argument("--masks", type=Path, help="folder of photographs and masks")
    parser.add_argument("--most", type=int, help="largest number of photographs with masks")
    parser.add_argument("--lake", type=Path, help="lake with the inspected demo")
    parser.add_argument("--portfolio", type=Path, default=Path("data/portfolio.yaml"), help="portfolio of the demo")
    options = parser.parse_args()
    if options.lake:
        print(compare_in_lake(options.lake, options.portfolio), end="\n\n")
    if options.cracks == 0:
        return
    trials = [trial for wall in ("render", "brick") for trial in measure_drawn_cracks(options.cracks, wall)]
    print(format_table(trials))
    median_ms = np.median([trial.seconds for trial in trials]) * 1000
    print(f"\nMedian {median_ms:.0f} ms per crack, with the blur of the photograph.")
    plot(trials, BUILD / "crack_width.png")
    if options.masks:
        print(compare_with_masks(options.masks, options.most))


if __name__ == "__main__":
    main()
