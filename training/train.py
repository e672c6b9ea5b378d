"""Train the shipped detector: `python -m training.train --data ../shared/data --weights ... --out ... --minutes 60`.

Warm-up, then a cosine down to nothing over the minutes given (time is what two cores have little of), a running mean
of the weights, mosaics switched off for the last part. A checkpoint every few minutes; `--resume` goes on from it.
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

from training.assign import cells_of
from training.data.sample import CLASSES
from training.loader import Batch, Order, batches
from training.loss import Truth, loss_of
from training.network import settle
from training.rivals import NETWORKS, network_of
from training.sources import drawn_samples, judged_samples, validation_samples
from training.validate import found_in, scores_of

_log = logging.getLogger("training")
INPUT_PX = 416  # side of the finished detector's input; it may learn on smaller ones, which is faster
WARM_UP = 0.03  # share of the time
LAST_PART = 0.15  # share of the time at the end without mosaics
KEEP = 0.998  # of the running mean of the weights, a step
REPORT = 20  # steps between lines of the log
LOOK_S = 480.0  # between looks at the pictures kept for choosing, each with a checkpoint
WORTH = {"real": 0.5, "areas": 0.3, "generated": 0.2}  # of the mean AP50 in choosing the best checkpoint
CLIP = 10.0  # norm of the gradient


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with defects/ and drone/")
    parser.add_argument("--generated", type=Path, nargs="*", default=(), help="folders written by training.generate")
    parser.add_argument("--judge", type=Path, nargs="*", default=(), help="real areas, as COCO, to choose by")
    parser.add_argument("--weights", type=Path, required=True, help="upstream's yolox_nano.onnx")
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoints and the log")
    parser.add_argument("--minutes", type=float, required=True, help="training time, in all")
    parser.add_argument("--start", type=Path, help="checkpoint whose weights to start from")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    parser.add_argument("--network", choices=NETWORKS, default=NETWORKS[0], help="others are to compare with")
    parser.add_argument("--side", type=int, default=INPUT_PX, help="of the pictures learned from")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--rate", type=float, default=1e-3, help="highest learning rate")
    parser.add_argument("--decay", type=float, default=0.05)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="of the network's arithmetic")
    parser.add_argument("--seed", type=int, default=0)
    train(parser.parse_args())


def train(options: argparse.Namespace) -> None:
    """The loop."""
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
    begun = torch.load(checkpoint) if options.resume and checkpoint.exists() else None
    context = multiprocessing.get_context("spawn")
    stop, mosaic = context.Event(), context.Event()
    mosaic.set()
    order = Order(
        data=options.data,
        generated=tuple(options.generated),
        side_px=options.side,
        batch=options.batch,
        seed=options.seed if begun is None else options.seed + begun["step"],
    )
    source = batches(order, stop=stop, mosaic=mosaic)
    cells = cells_of(options.side, options.side)
    network = network_of(options.network, options.weights, len(CLASSES))
    if begun is None and options.start is None:
        if options.network == "yolox-nano":
            settle(network, _images(next(source)))
    elif begun is None:
        network.load_state_dict(torch.load(options.start)["mean"])
    mean = copy.deepcopy(network)
    optimiser = torch.optim.AdamW(_groups(network, options.decay), lr=options.rate, betas=(0.9, 0.99))
    step, spent, best = 0, 0.0, 0.0
    if begun is not None:
        network.load_state_dict(begun["network"])
        mean.load_state_dict(begun["mean"])
        optimiser.load_state_dict(begun["optimiser"])
        step, spent, best = begun["step"], begun["spent_s"], begun["best"]
    judged_cells = cells_of(INPUT_PX, INPUT_PX)
    judged = {
        "real": validation_samples(options.data),
        "areas": judged_samples(options.judge),
        "generated": drawn_samples(options.generated),
    }
    last_look, sums = time.monotonic(), np.zeros(4)
    while spent < options.minutes * 60:
        began = time.monotonic()
        share = spent / (options.minutes * 60)
        if share > 1 - LAST_PART:
            mosaic.clear()
        for group in optimiser.param_groups:
            group["lr"] = options.rate * rate_at(share)
        batch = next(source)
        waited = time.monotonic() - began
        network.train()
        loss = loss_of(network(_images(batch)), _truths(batch), cells)
        optimiser.zero_grad(set_to_none=True)
        loss.total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), CLIP)
        optimiser.step()
        step += 1
        _follow(mean, network, min(KEEP, (1 + step) / (10 + step)))
        spent += time.monotonic() - began
        sums += [loss.box, loss.objectness, loss.classes, waited]
        if step % REPORT == 0:
            box, objectness, classes, waiting = sums / REPORT
            _log.info(
                "step %d %4.1f min %.1f img/s box %.3f object %.3f class %.3f (waited %.2f s)",
                step, spent / 60, step * options.batch / spent, box, objectness, classes, waiting,
            )  # fmt: skip
            sums[:] = 0
        if time.monotonic() - last_look > LOOK_S or spent >= options.minutes * 60:
            last_look = time.monotonic()
            scores = {
                name: scores_of(samples, found_in(mean, samples, judged_cells, INPUT_PX))
                for name, samples in judged.items()
                if samples
            }
            for name, score in scores.items():
                said = ", ".join(f"{kind} {score.ap50[kind]:.3f} / {score.ap[kind]:.3f}" for kind in score.ap50)
                _log.info("step %d %s AP50 / AP: %s; false boxes %.2f", step, name, said, score.false_boxes)
            state = {"network": network.state_dict(), "mean": mean.state_dict(), "optimiser": optimiser.state_dict()}
            worth = sum(WORTH[name] * score.mean for name, score in scores.items())
            if worth >= best:
                best = worth
                torch.save({"mean": mean.state_dict(), "step": step}, options.out / "best.pt")
            torch.save({**state, "step": step, "spent_s": spent, "best": best}, checkpoint.with_suffix(".new"))
            checkpoint.with_suffix(".new").replace(checkpoint)
    stop.set()


def rate_at(share: float) -> float:
    """Learning rate, of its highest, after that share of the time: up in a line, down in a cosine to 2 %."""
    if share < WARM_UP:
        return max(share / WARM_UP, 0.01)
    return 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * (share - WARM_UP) / (1 - WARM_UP)))


def _groups(network: nn.Module, decay: float) -> list[dict[str, object]]:
    """Weights of convolutions decay, biases and norms do not."""
    decaying = [p for p in network.parameters() if p.ndim > 1]
    free = [p for p in network.parameters() if p.ndim <= 1]
    return [{"params": decaying, "weight_decay": decay}, {"params": free, "weight_decay": 0.0}]


@torch.no_grad()
def _follow(mean: nn.Module, network: nn.Module, keep: float) -> None:
    for old, new in zip(mean.state_dict().values(), network.state_dict().values(), strict=True):
        if old.dtype.is_floating_point:
            old.lerp_(new, 1 - keep)
        else:
            old.copy_(new)


def _images(batch: Batch) -> torch.Tensor:
    return torch.from_numpy(batch[0]).permute(0, 3, 1, 2).float()


def _truths(batch: Batch) -> list[Truth]:
    return [
        Truth(boxes_px=boxes.astype(np.float32), classes=classes)
        for boxes, classes in zip(batch[1], batch[2], strict=True)
    ]


if __name__ == "__main__":
    main()
