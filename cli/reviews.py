"""Commands for reviews and what is made of them: training sets, comparisons of models, promotion."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cli.options import (
    DEFAULT_LAKE,
    DEFAULT_PORTFOLIO,
    AnyPortfolioPath,
    AsOf,
    BuildingId,
    CampaignId,
    ExistingLakePath,
    PortfolioPath,
    console,
    read_portfolio_at,
    require_output_folder,
)
from facadelake.core.errors import InputDataError
from facadelake.reviews.training import PictureMode, TrainingLabelFormat

review = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Reviews of detections: export a task, import reviews, list the current ones; and of the state of a track "
    "(docs/reviews-and-training.md).",
)


@review.command("export-task")
def export_task(
    building: BuildingId,
    campaign: CampaignId,
    folder: Annotated[Path, typer.Argument(help="Folder to write the task to.")],
    photo: Annotated[
        list[str] | None, typer.Option(help="Only this photograph, by its photo_id. Repeatable; default: all.")
    ] = None,
    unreviewed: Annotated[
        bool, typer.Option("--unreviewed", help="Only photographs with a detection that has no review.")
    ] = False,
    score_min: Annotated[float, typer.Option(min=0, max=1, help="Leave out detections with a lower score.")] = 0.0,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Write a campaign's detections as COCO for CVAT or Label Studio, and its defects as a table to fill in.

    Everything in an exported photograph counts as reviewed when the task is imported: export what will be reviewed.
    """
    from cli.terminal.reviews import show_task
    from facadelake.campaigns import resolve_campaign
    from facadelake.lake import resolve_version
    from facadelake.reviews import export_task as write

    registered = read_portfolio_at(portfolio).get_building(building)
    require_output_folder(folder, "FOLDER")
    task, files = write(
        registered,
        resolve_campaign(registered, campaign),
        folder,
        lake=lake,
        photographs=tuple(photo or ()),
        only_unreviewed=unreviewed,
        score_min=score_min,
        as_of=resolve_version(lake, as_of),
    )
    show_task(console, task, files)


@review.command("import")
def import_reviews(
    building: BuildingId,
    campaign: CampaignId,
    file: Annotated[Path, typer.Argument(help="The completed table (.csv) or the corrected COCO file (.json).")],
    *,
    reviewer: Annotated[str, typer.Option(help="Name of the reviewer.")],
    task: Annotated[
        Path | None,
        typer.Option(help="The COCO file as exported: a box missing from FILE is then rejected."),
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Add reviews to the lake: confirmed, rejected, corrected, missed. The latest review of a subject counts.

    Running it again adds nothing. Defects and published files are not changed.
    """
    from cli.terminal.reviews import show_import
    from facadelake.campaigns import resolve_campaign
    from facadelake.reviews import import_reviews as add

    registered = read_portfolio_at(portfolio).get_building(building)
    chosen = resolve_campaign(registered, campaign)
    show_import(console, add(registered, chosen, file, lake=lake, reviewer=reviewer, task=task))


@review.command("list")
def list_reviews(
    building: BuildingId,
    campaign: Annotated[str | None, typer.Argument(help="Only this campaign.")] = None,
    lines: Annotated[bool, typer.Option("--lines", help="List each review, not only the counts.")] = False,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """List the current reviews of a building's detections, and reviews whose detection no longer exists."""
    from cli.terminal.reviews import show_reviews
    from facadelake.lake import read_table, resolve_version
    from facadelake.reviews import read_reviewed_campaign

    registered = read_portfolio_at(portfolio).get_building(building)
    version = resolve_version(lake, as_of)
    held = read_table(lake, "campaigns", building_id=building, as_of=version).column("campaign_id").to_pylist()
    chosen = [campaign] if campaign else sorted(held)
    if not chosen:
        raise InputDataError(f"the lake {lake} holds no campaign of '{building}'; inspect one first")
    reviewed = [read_reviewed_campaign(registered, one, lake=lake, as_of=version) for one in chosen]
    show_reviews(console, reviewed, lines=lines)


@review.command("track")
def review_track(
    track: Annotated[str, typer.Argument(help="Id of the track, such as castle-0042 ('facadelake tracks').")],
    campaign: Annotated[str, typer.Argument(help="The campaign in which it is reviewed.")],
    state: Annotated[
        str,
        typer.Argument(
            help="What became of it there: new, first_seen, seen, grown, shrunk, repaired, not_found, not_imaged or "
            "reopened."
        ),
    ],
    *,
    reviewer: Annotated[str, typer.Option(help="Name of the reviewer.")],
    note: Annotated[str | None, typer.Option(help="What else there is to say.")] = None,
    portfolio: AnyPortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Give a defect its state in a campaign, in place of what tracking found. The latest review counts.

    'facadelake track BUILDING', or the next inspection, applies it; later runs keep it.
    """
    from cli.terminal.tracks import show_track_review
    from facadelake.reviews import review_track as add

    done = add(lake, track, campaign, state, reviewer=reviewer, note=note)
    show_track_review(console, done, track, campaign, state)


def training_set(
    buildings: Annotated[list[str], typer.Argument(help="Ids of the buildings whose reviewed campaigns are used.")],
    *,
    out: Annotated[Path, typer.Option(help="Folder to create; it must not exist.")],
    form: Annotated[
        TrainingLabelFormat, typer.Option("--format", help="Format of the labels.")
    ] = TrainingLabelFormat.COCO,
    pictures: Annotated[
        PictureMode,
        typer.Option(
            help="tiles around the reviewed places, with unreviewed detections masked; or whole photographs, copied or "
            "linked, in which every detection was reviewed."
        ),
    ] = PictureMode.TILES,
    tile_px: Annotated[int, typer.Option(min=64, max=8192, help="Side of a tile.")] = 640,
    split: Annotated[
        list[str] | None,
        typer.Option(help="BUILDING=train, val or test; default: by the hash of the building's id. Repeatable."),
    ] = None,
    terms: Annotated[str | None, typer.Option(help="Terms of use of the photographs, for the manifest.")] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Write reviewed detections as a training set; rejected detections become images without a defect.

    Each building is in one split only, so that no wall is used for both training and evaluation.
    """
    from cli.terminal.reviews import show_training_set
    from facadelake.lake import resolve_version
    from facadelake.reviews.training import make_training_set

    registered = [read_portfolio_at(portfolio).get_building(one) for one in dict.fromkeys(buildings)]
    done, placed = make_training_set(
        registered,
        out,
        lake=lake,
        label_format=form,
        pictures=pictures,
        side_px=tile_px,
        splits=tuple(split or ()),
        terms=terms,
        as_of=resolve_version(lake, as_of),
    )
    show_training_set(console, done, placed)


def compare_models(
    old: Annotated[str, typer.Argument(help="The model in use: an ONNX file with its card, or 'default'.")],
    new: Annotated[Path, typer.Argument(help="The candidate: an ONNX file with its card.")],
    *,
    campaign: Annotated[
        list[str], typer.Option(help="A committed campaign to compare on, as BUILDING/CAMPAIGN. Repeatable.")
    ],
    sample: Annotated[
        int | None,
        typer.Option(min=1, help="Maximum number of photographs of each campaign, reviewed ones first; default: all."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="Folder to write to; default: one in the lake's 'comparisons'.")
    ] = None,
    as_of: AsOf = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Compare two models on committed campaigns: detections and defects that stay, appear and vanish.

    With reviews it reports which confirmed defects the new model loses and which rejected detections it drops.
    Committed data are not changed; the detections are cached, so that running it again is quick.
    """
    from cli.terminal.reviews import show_comparison
    from facadelake.detection import find_default_model
    from facadelake.evaluation.model_comparison import compare_models as compare
    from facadelake.lake import resolve_version

    require_output_folder(output, "--output")
    done = compare(
        read_portfolio_at(portfolio),
        find_default_model() if old == "default" else Path(old),
        new,
        campaign,
        lake=lake,
        sample=sample,
        folder=output,
        as_of=resolve_version(lake, as_of),
    )
    if as_json:
        sys.stdout.write(done.comparison.model_dump_json(indent=2) + "\n")
    else:
        show_comparison(console, done)


def promote_model(
    new: Annotated[Path, typer.Argument(help="The ONNX file, with its card.")],
    *,
    by: Annotated[str, typer.Option(help="Name of the person who decides.")],
    why: Annotated[str, typer.Option(help="Reason, for the record.")],
    max_lost: Annotated[int, typer.Option(min=0, help="Number of confirmed defects that may be lost.")] = 0,
    min_confirmed: Annotated[int, typer.Option(min=0, help="Confirmed defects that the comparison must cover.")] = 10,
    report: Annotated[
        Path | None,
        typer.Option(help="The comparison.json; default: of the default model and NEW, in the lake."),
    ] = None,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Make a model the default detector ('model: default') if its comparison and its card allow it.

    Earlier models are kept; data/detector/models.yaml records who decided what, when and why.
    """
    from facadelake.evaluation.model_comparison import promote_model as promote

    entry, evidence = promote(
        new, lake=lake, report=report, by=by, why=why, lost_max=max_lost, confirmed_min=min_confirmed
    )
    console.print(f"the default detector is {entry.file} ({entry.sha256[:12]}), promoted by {entry.by}: {entry.why}")
    console.print(evidence, soft_wrap=True, highlight=False)
