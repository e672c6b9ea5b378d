"""Commands of the loop: reviews, training sets made of them, a new model compared with the old, and promoted."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cli.options import (
    DEFAULT_LAKE,
    DEFAULT_PORTFOLIO,
    BuildingId,
    CampaignId,
    LakePath,
    PortfolioPath,
    console,
    portfolio_at,
)
from facadelake.core.errors import InputDataError
from facadelake.reviews.training import LabelForm, Pictures

review = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="What persons say of detections: export a task, bring their words in, list what holds (docs/the-loop.md).",
)


@review.command("export-task")
def export_task(
    building: BuildingId,
    campaign: CampaignId,
    folder: Annotated[Path, typer.Argument(help="Folder to write the task to.")],
    photo: Annotated[
        list[str] | None, typer.Option(help="Only this photograph, by its photo_id. Repeatable; all if left out.")
    ] = None,
    unreviewed: Annotated[
        bool, typer.Option("--unreviewed", help="Only photographs with a detection that nobody has spoken of.")
    ] = False,
    score_min: Annotated[float, typer.Option(min=0, max=1, help="Leave out detections with a lower score.")] = 0.0,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Write a campaign's detections as COCO for CVAT or Label Studio, and its defects as a table to fill in.

    What a photograph of the task shows counts as looked at when it comes back: export what will be looked at.
    """
    from cli.terminal.reviews import show_task
    from facadelake.campaigns import resolved_campaign
    from facadelake.reviews import export_task as write

    registered = portfolio_at(portfolio).building(building)
    task, files = write(
        registered,
        resolved_campaign(registered, campaign),
        folder,
        lake=lake,
        photographs=tuple(photo or ()),
        only_unreviewed=unreviewed,
        score_min=score_min,
    )
    show_task(console, task, files)


@review.command("import")
def import_reviews(
    building: BuildingId,
    campaign: CampaignId,
    file: Annotated[Path, typer.Argument(help="The table that was filled in (.csv), or the corrected COCO (.json).")],
    *,
    reviewer: Annotated[str, typer.Option(help="Who says it.")],
    task: Annotated[
        Path | None,
        typer.Option(help="The COCO file as it was exported: then a box that is gone from FILE is rejected."),
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Add a person's words to the lake: confirmed, rejected, corrected, missed. The last word counts.

    Running it again adds nothing. Defects and published files stay as they are.
    """
    from cli.terminal.reviews import show_import
    from facadelake.campaigns import resolved_campaign
    from facadelake.reviews import import_reviews as add

    registered = portfolio_at(portfolio).building(building)
    chosen = resolved_campaign(registered, campaign)
    show_import(console, add(registered, chosen, file, lake=lake, reviewer=reviewer, task=task))


@review.command("list")
def list_reviews(
    building: BuildingId,
    campaign: Annotated[str | None, typer.Argument(help="Only this campaign.")] = None,
    lines: Annotated[bool, typer.Option("--lines", help="Each word, not only the counts.")] = False,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """List what holds of a building's detections after all words, and words that meet no detection any more."""
    from cli.terminal.reviews import show_reviews
    from facadelake.lake import read_table
    from facadelake.reviews import reviewed_campaign

    registered = portfolio_at(portfolio).building(building)
    held = read_table(lake, "campaigns", building_id=building).column("campaign_id").to_pylist()
    chosen = [campaign] if campaign else sorted(held)
    if not chosen:
        raise InputDataError(f"the lake {lake} holds no campaign of '{building}'; inspect one first")
    show_reviews(console, [reviewed_campaign(registered, one, lake=lake) for one in chosen], lines=lines)


def training_set(
    buildings: Annotated[list[str], typer.Argument(help="Ids of the buildings whose reviewed campaigns are taken.")],
    *,
    out: Annotated[Path, typer.Option(help="Folder to write; it must not be there yet.")],
    form: Annotated[LabelForm, typer.Option("--format", help="How labels are written.")] = LabelForm.COCO,
    pictures: Annotated[
        Pictures,
        typer.Option(
            help="tiles about the reviewed places, what nobody judged hidden; or whole photographs, copied or linked, "
            "where every detection was judged."
        ),
    ] = Pictures.TILES,
    tile_px: Annotated[int, typer.Option(min=64, max=8192, help="Side of a tile.")] = 640,
    split: Annotated[
        list[str] | None,
        typer.Option(help="BUILDING=train, val or test instead of the one by the hash of its id. Repeatable."),
    ] = None,
    terms: Annotated[
        str | None, typer.Option(help="Under which terms the photographs may be used, for the manifest.")
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Write reviewed detections as a training set; rejected ones become pictures without a defect.

    A building is wholly in one split, so that no wall is both learned from and judged by.
    """
    from cli.terminal.reviews import show_training_set
    from facadelake.reviews.training import make_training_set

    registered = [portfolio_at(portfolio).building(one) for one in dict.fromkeys(buildings)]
    done, placed = make_training_set(
        registered,
        out,
        lake=lake,
        form=form,
        pictures=pictures,
        side_px=tile_px,
        splits=tuple(split or ()),
        terms=terms,
    )
    show_training_set(console, done, placed)


def compare_models(
    old: Annotated[str, typer.Argument(help="The model in use: an ONNX file with its card, or 'default'.")],
    new: Annotated[Path, typer.Argument(help="The model that may replace it: an ONNX file with its card.")],
    *,
    campaign: Annotated[
        list[str], typer.Option(help="A committed campaign to look at, as BUILDING/CAMPAIGN. Repeatable.")
    ],
    sample: Annotated[
        int | None,
        typer.Option(min=1, help="At most so many photographs of each campaign, reviewed ones first; all if left out."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="Folder to write to; one below the lake's 'comparisons' if left out.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Compare two models on stored campaigns: what stays, appears and vanishes, in photographs and on the wall.

    Against reviews it tells which confirmed defects the new one loses and which rejected ones it drops. Nothing that is
    committed changes; what a model found is cached, so that running it again is quick.
    """
    from cli.terminal.reviews import show_comparison
    from facadelake.detection import default_model
    from facadelake.evaluation.model_comparison import compare_models as compare

    done = compare(
        portfolio_at(portfolio),
        default_model() if old == "default" else Path(old),
        new,
        campaign,
        lake=lake,
        sample=sample,
        folder=output,
    )
    if as_json:
        sys.stdout.write(done.comparison.model_dump_json(indent=2) + "\n")
    else:
        show_comparison(console, done)


def promote_model(
    new: Annotated[Path, typer.Argument(help="The ONNX file, with its card.")],
    *,
    by: Annotated[str, typer.Option(help="Who decides.")],
    why: Annotated[str, typer.Option(help="Why.")],
    max_lost: Annotated[int, typer.Option(min=0, help="So many confirmed defects may be lost.")] = 0,
    min_confirmed: Annotated[int, typer.Option(min=0, help="So many confirmed defects must have been looked at.")] = 10,
    report: Annotated[
        Path | None, typer.Option(help="The comparison.json; the one of the default and NEW in the lake if left out.")
    ] = None,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Make a model the default detector ('model: default'), if its comparison with the present one and its card allow.

    The earlier models stay beside it; data/detector/models.yaml says who decided what, when and why.
    """
    from facadelake.evaluation.model_comparison import promote_model as promote

    entry, told = promote(new, lake=lake, report=report, by=by, why=why, lost_max=max_lost, confirmed_min=min_confirmed)
    console.print(f"the default detector is {entry.file} ({entry.sha256[:12]}), decided by {entry.by}: {entry.why}")
    console.print(told, soft_wrap=True, highlight=False)
