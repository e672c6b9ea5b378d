"""The network, its loss and its export, with torch where it is installed (extra `training`)."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra 'training')")
pytest.importorskip("onnx2torch", reason="onnx2torch is not installed (extra 'training')")

SHARED = Path(os.environ.get("FACADELAKE_SHARED_DATA", Path(__file__).parents[4] / "shared" / "data"))
WEIGHTS = SHARED / "weights" / "yolox_nano_coco" / "yolox_nano.onnx"
needs_weights = pytest.mark.skipif(not WEIGHTS.exists(), reason=f"{WEIGHTS} is not there")


def _images(count: int) -> torch.Tensor:
    rng = np.random.default_rng(0)
    blocks = rng.integers(0, 256, (count, 3, 26, 26)).repeat(16, axis=2).repeat(16, axis=3)
    return torch.from_numpy(blocks.astype(np.float32))


@needs_weights
def test_the_initialised_network_computes_what_upstream_does() -> None:
    import onnxruntime

    from training.network import initialise_norms, load_yolox

    network = load_yolox(WEIGHTS, class_count=3)
    images = _images(4)
    initialise_norms(network, images)
    with torch.no_grad():
        made = network(images[:1])[0].numpy()
    (upstream,) = onnxruntime.InferenceSession(str(WEIGHTS)).run(None, {"images": images[:1].numpy()})
    np.testing.assert_allclose(made[:, :4], upstream[0, :, :4], rtol=0, atol=1e-3)  # cells
    np.testing.assert_allclose(1 / (1 + np.exp(-made[:, 4])), upstream[0, :, 4], rtol=0, atol=1e-4)


@needs_weights
def test_the_export_computes_what_the_network_does_in_any_batch() -> None:
    import onnx
    import onnxruntime

    from training.export import insert_weights, measure_difference
    from training.network import initialise_norms, load_yolox

    network = load_yolox(WEIGHTS, class_count=3)
    initialise_norms(network, _images(4))
    model = insert_weights(network, onnx.load(WEIGHTS))
    assert measure_difference(network, model) < 1e-3
    session = onnxruntime.InferenceSession(model.SerializeToString())
    (three,) = session.run(None, {"images": _images(3).numpy()})
    assert three.shape == (3, 3549, 8)


def test_the_loss_falls_to_the_box_that_is_meant() -> None:
    """Raw outputs optimised directly: after 120 steps the best cell predicts the box and its class."""
    from training.assign import decode, list_cells
    from training.loss import TargetBoxes, compute_loss

    cells = list_cells(96, 96)
    raw = torch.zeros(1, len(cells.stride_px), 8)
    raw[..., 4:] = -3
    raw.requires_grad_()
    truth = TargetBoxes(boxes_px=np.array([[20, 30, 80, 50]], np.float32), classes=np.array([1]))
    optimiser = torch.optim.Adam([raw], lr=0.1)
    losses = []
    for _ in range(120):
        loss = compute_loss(raw, [truth], cells)
        optimiser.zero_grad()
        loss.total.backward()
        optimiser.step()
        losses.append(float(loss.total))
    assert losses[-1] < 0.2 * losses[0]
    predicted = raw.detach().numpy()[0]
    best = int(np.argmax(predicted[:, 4]))
    np.testing.assert_allclose(decode(predicted[:, :4], cells)[best], truth.boxes_px[0], rtol=0, atol=3)  # px
    assert int(np.argmax(predicted[best, 5:])) == 1


def test_a_picture_without_defects_wants_low_objectness() -> None:
    from training.assign import list_cells
    from training.loss import TargetBoxes, compute_loss

    cells = list_cells(96, 96)
    nothing = TargetBoxes(boxes_px=np.zeros((0, 4), np.float32), classes=np.zeros(0, np.int64))
    quiet, loud = torch.full((1, len(cells.stride_px), 8), -8.0), torch.full((1, len(cells.stride_px), 8), 2.0)
    assert float(compute_loss(quiet, [nothing], cells).total) < 0.1 < float(compute_loss(loud, [nothing], cells).total)
