"""Commands that evaluate and describe detectors. The lake is not used."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from cli.options import console, problems, require_output_folder
from facadelake.core.errors import InputDataError
from facadelake.evaluation.detectors.labels import LabelFormat
from schemas.vocabulary import DefectClass


def evaluate_detector(
    model: Annotated[
        str, typer.Option(help="'default', an ONNX model with its card, or another program's detections (COCO, .json).")
    ] = "default",
    data: Annotated[
        list[Path] | None,
        typer.Option(help="Labelled photographs: a COCO file, or a folder in COCO, YOLO or VOC format. Repeatable."),
    ] = None,
    form: Annotated[LabelFormat, typer.Option("--format", help="Format of --data.")] = LabelFormat.AUTO,
    classes: Annotated[
        str | None,
        typer.Option(help="Class names by YOLO's class number, such as crack,spalling, if no file has them."),
    ] = None,
    sites: Annotated[
        Path | None,
        typer.Option(help="Site of each photograph: CSV (image, site, split), or YAML (training/data/sites.yaml)."),
    ] = None,
    split: Annotated[str | None, typer.Option(help="Evaluate on this split only, such as test.")] = None,
    labelled: Annotated[
        list[DefectClass] | None,
        typer.Option(help="The data are labelled for this class only, whatever they list. Repeatable."),
    ] = None,
    negatives: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of photographs without defects, for false alarm rates. Repeatable."),
    ] = None,
    scale: Annotated[
        Path | None,
        typer.Option(help="CSV: image and gsd_mm (mm per pixel) or area_m2 (of facade in it), for rates per m2."),
    ] = None,
    image_labels: Annotated[
        list[Path] | None,
        typer.Option(help="Photographs labelled as a whole, in folders named by class (spalling, intact), for AUROC."),
    ] = None,
    threshold: Annotated[float | None, typer.Option(min=0, max=1, help="Score threshold; default: the card's.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON with stable keys.")] = False,
    plots: Annotated[
        Path | None,
        typer.Option(help="Folder for plots: curves, reliability, sites, worst false alarms and misses."),
    ] = None,
    write_card: Annotated[bool, typer.Option("--write-card", help="Write the figures into the model's card.")] = False,
) -> None:
    """Evaluate a detector: average precision, false alarms per m2, calibration, sites, confusions, the worst images.

    Nothing is tuned: the card's threshold is used. Evaluate on sites that the model was not trained on.
    """
    from cli.terminal.detectors import show_answer, write_pictures
    from cli.terminal.run import ProgressBars
    from facadelake.core.progress import listen_to_progress
    from facadelake.evaluation.detectors import (
        DetectorEvaluationRequest,
        evaluate_prediction_source,
        locate_model_file,
        open_prediction_source,
        write_results,
    )

    path = locate_model_file(model)
    if write_card and (path.suffix.lower() != ".onnx" or threshold is not None):
        raise InputDataError("--write-card is for ONNX models at the threshold of their card; omit --threshold")
    question = DetectorEvaluationRequest(
        data=tuple(data or ()),
        label_format=form,
        class_names=tuple(name.strip() for name in (classes or "").split(",") if name.strip()),
        sites=sites,
        split=split,
        labelled=frozenset(labelled) if labelled else None,
        negatives=tuple(negatives or ()),
        scale=scale,
        image_labels=tuple(image_labels or ()),
    )
    require_output_folder(plots, "--plots")
    looker, crosswalk = open_prediction_source(path, threshold)
    if plots is not None:
        plots.mkdir(parents=True, exist_ok=True)
    with ProgressBars(problems) as bars, listen_to_progress(bars):
        answer = evaluate_prediction_source(looker, crosswalk, question)
    figures = None if answer.boxes is None else answer.boxes.figures
    for written in write_pictures(answer, plots) if plots is not None else ():
        problems.print(f"written: {written}", soft_wrap=True, highlight=False)
    if write_card:
        command = shlex.join(["facadelake", *sys.argv[1:]])
        written = write_results(path, figures, answer.image_labels, command=command)
        problems.print(f"written: {written}", soft_wrap=True, highlight=False)
    if as_json:
        found: dict[str, object] = {} if figures is None else figures.convert_to_json()
        found["image_labels"] = [one.convert_to_json() for one in answer.image_labels]
        sys.stdout.write(json.dumps(found, indent=2) + "\n")
    else:
        show_answer(console, answer)


def describe_detector(
    model: Annotated[str, typer.Option(help="'default' or an ONNX model with its card.")] = "default",
    output: Annotated[Path | None, typer.Option(help="File to write; default: print.")] = None,
) -> None:
    """Write the Markdown page of a model from its card: terms, training data, figures by class and site."""
    from facadelake.evaluation.detectors import locate_model_file, render_model_page

    path = locate_model_file(model)
    if path.suffix.lower() != ".onnx":
        raise InputDataError(f"{path} is not an ONNX model; only a model with a card can be described")
    text = render_model_page(path)
    if output is None:
        sys.stdout.write(text)
        return
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(text, encoding="utf-8")
    console.print(f"written: {output}", soft_wrap=True, highlight=False)
