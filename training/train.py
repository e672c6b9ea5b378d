"""Train the shipped detector: `python -m training.train --data ../shared/data --weights ... --out ... --minutes 60`.

The learning rate rises in a warm-up and then decreases as a cosine over the given minutes, because time is the limit on
two cores. A running mean of the weights is validated and exported. Mosaics are switched off near the end. Checkpoints
are written every few minutes; `--resume` continues from the last one.
"""

from __future__ import annotations

import argparse
import copy
import logging
import math
import multiprocessing
import os
import time
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn

from training.assign import list_cells
from training.comparison_networks import NETWORKS, create_network
from training.data.sample import CLASSES
from training.loader import Batch, LoaderOptions, generate_batches
from training.loss import TargetBoxes, compute_loss
from training.network import initialise_norms
from training.sources import read_evaluation_samples, read_generated_samples, read_validation_samples
from training.validate import compute_scores, detect_boxes

_log = logging.getLogger("training")
INPUT_PX = 416  # side of the input at inference and validation; training on smaller ones is faster
WARM_UP_SHARE = 0.03  # of the time
NO_MOSAIC_SHARE = 0.15  # of the time, at the end
MEAN_DECAY = 0.998  # of the running mean of the weights, per step
LOG_INTERVAL = 20  # steps between lines of the log
VALIDATION_INTERVAL_S = 480.0  # between validations, each with a checkpoint
SET_WEIGHTS = {"real": 0.5, "areas": 0.3, "generated": 0.2}  # of the mean AP50, to choose the best checkpoint
GRADIENT_NORM_MAX = 10.0


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with defects/ and drone/")
    parser.add_argument("--generated", type=Path, nargs="*", default=(), help="folders written by training.generate")
    parser.add_argument("--validation", type=Path, nargs="*", default=(), help="validation sets with areas, COCO")
    parser.add_argument("--weights", type=Path, required=True, help="upstream's yolox_nano.onnx")
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoints and the log")
    parser.add_argument("--minutes", type=float, required=True, help="total training time")
    parser.add_argument("--start", type=Path, help="checkpoint with the initial weights")
    parser.add_argument("--resume", action="store_true", help="continue from the checkpoint in --out")
    parser.add_argument("--network", choices=NETWORKS, default=NETWORKS[0], help="all but the first are for comparison")
    parser.add_argument("--side", type=int, default=INPUT_PX, help="width and height of training pictures in pixels")
    parser.add_argument("--batch", type=int, default=16, help="pictures per step")
    parser.add_argument("--rate", type=float, default=1e-3, help="highest learning rate")
    parser.add_argument("--decay", type=float, default=0.05, help="weight decay")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="threads of torch")
    parser.add_argument("--seed", type=int, default=0, help="seed of weights and examples")
    train(parser.parse_args())


def train(options: argparse.Namespace) -> None:
    """Train until the time is used; write checkpoints, the best running mean and a log."""
    options.out.mkdir(parents=True, exist_ok=True)
    logging.basicConfig(
        level=logging.INFO,
        format="%(asctime)s %(message)s",
        datefmt="%H:%M:%S",
        handlers=[logging.StreamHandler(), logging.FileHandler(options.out / "train.log")],
    )
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    checkpoint = options.out / "checkpoint.pt"
    resumed = torch.load(checkpoint) if options.resume and checkpoint.exists() else None
    context = multiprocessing.get_context("spawn")
    stop, mosaic = context.Event(), context.Event()
    mosaic.set()
    loader_options = LoaderOptions(
        data=options.data,
        generated=tuple(options.generated),
        side_px=options.side,
        batch=options.batch,
        seed=options.seed if resumed is None else options.seed + resumed["step"],
    )
    source = generate_batches(loader_options, stop=stop, mosaic=mosaic)
    cells = list_cells(options.side, options.side)
    network = create_network(options.network, options.weights, len(CLASSES))
    if resumed is None and options.start is None:
        if options.network == "yolox-nano":
            initialise_norms(network, _convert_images(next(source)))
    elif resumed is None:
        network.load_state_dict(torch.load(options.start)["mean"])
    mean = copy.deepcopy(network)
    optimiser = torch.optim.AdamW(_group_parameters(network, options.decay), lr=options.rate, betas=(0.9, 0.99))
    step, spent, best = 0, 0.0, 0.0
    if resumed is not None:
        network.load_state_dict(resumed["network"])
        mean.load_state_dict(resumed["mean"])
        optimiser.load_state_dict(resumed["optimiser"])
        step, spent, best = resumed["step"], resumed["spent_s"], resumed["best"]
    validation_cells = list_cells(INPUT_PX, INPUT_PX)
    validation_sets = {
        "real": read_validation_samples(options.data),
        "areas": read_evaluation_samples(options.validation),
        "generated": read_generated_samples(options.generated),
    }
    last_validation, sums = time.monotonic(), np.zeros(4)
    while spent < options.minutes * 60:
        step_start = time.monotonic()
        share = spent / (options.minutes * 60)
        if share > 1 - NO_MOSAIC_SHARE:
            mosaic.clear()
        for group in optimiser.param_groups:
            group["lr"] = options.rate * compute_learning_rate(share)
        batch = next(source)
        waited = time.monotonic() - step_start
        network.train()
        loss = compute_loss(network(_convert_images(batch)), _convert_targets(batch), cells)
        optimiser.zero_grad(set_to_none=True)
        loss.total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), GRADIENT_NORM_MAX)
        optimiser.step()
        step += 1
        _update_mean(mean, network, min(MEAN_DECAY, (1 + step) / (10 + step)))
        spent += time.monotonic() - step_start
        sums += [loss.box, loss.objectness, loss.classes, waited]
        if step % LOG_INTERVAL == 0:
            box, objectness, classes, waiting = sums / LOG_INTERVAL
            _log.info(
                "step %d %4.1f min %.1f img/s box %.3f object %.3f class %.3f (waited %.2f s)",
                step, spent / 60, step * options.batch / spent, box, objectness, classes, waiting,
            )  # fmt: skip
            sums[:] = 0
        if time.monotonic() - last_validation > VALIDATION_INTERVAL_S or spent >= options.minutes * 60:
            last_validation = time.monotonic()
            scores = {
                name: compute_scores(samples, detect_boxes(mean, samples, validation_cells, INPUT_PX))
                for name, samples in validation_sets.items()
                if samples
            }
            for name, score in scores.items():
                figures = ", ".join(f"{kind} {score.ap50[kind]:.3f} / {score.ap[kind]:.3f}" for kind in score.ap50)
                _log.info("step %d %s AP50 / AP: %s; false boxes %.2f", step, name, figures, score.false_boxes)
            state = {"network": network.state_dict(), "mean": mean.state_dict(), "optimiser": optimiser.state_dict()}
            score_sum = sum(SET_WEIGHTS[name] * score.mean for name, score in scores.items())
            if score_sum >= best:
                best = score_sum
                torch.save({"mean": mean.state_dict(), "step": step}, options.out / "best.pt")
            torch.save({**state, "step": step, "spent_s": spent, "best": best}, checkpoint.with_suffix(".new"))
            checkpoint.with_suffix(".new").replace(checkpoint)
    stop.set()


def compute_learning_rate(share: float) -> float:
    """Learning rate, relative to the highest, after this share of time: a linear rise, then a cosine down to 2 %."""
    if share < WARM_UP_SHARE:
        return max(share / WARM_UP_SHARE, 0.01)
    return 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * (share - WARM_UP_SHARE) / (1 - WARM_UP_SHARE)))


def _group_parameters(network: nn.Module, decay: float) -> list[dict[str, object]]:
    """Parameter groups of the optimiser: weight decay for convolutions, none for biases and normalisations."""
    decaying = [p for p in network.parameters() if p.ndim > 1]
    free = [p for p in network.parameters() if p.ndim <= 1]
    return [{"params": decaying, "weight_decay": decay}, {"params": free, "weight_decay": 0.0}]


@torch.no_grad()
def _update_mean(mean: nn.Module, network: nn.Module, keep: float) -> None:
    for old, new in zip(mean.state_dict().values(), network.state_dict().values(), strict=True):
        if old.dtype.is_floating_point:
            old.lerp_(new, 1 - keep)
        else:
            old.copy_(new)


def _convert_images(batch: Batch) -> torch.Tensor:
    return torch.from_numpy(batch[0]).permute(0, 3, 1, 2).float()


def _convert_targets(batch: Batch) -> list[TargetBoxes]:
    return [
        TargetBoxes(boxes_px=boxes.astype(np.float32), classes=classes)
        for boxes, classes in zip(batch[1], batch[2], strict=True)
    ]


if __name__ == "__main__":
    main()
