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
def test_the_settled_network_computes_what_upstream_does() -> None:
    import onnxruntime

    from training.network import settle, trainable

    network = trainable(WEIGHTS, class_count=3)
    images = _images(4)
    settle(network, images)
    with torch.no_grad():
        made = network(images[:1])[0].numpy()
    (upstream,) = onnxruntime.InferenceSession(str(WEIGHTS)).run(None, {"images": images[:1].numpy()})
    np.testing.assert_allclose(made[:, :4], upstream[0, :, :4], rtol=0, atol=1e-3)  # cells
    np.testing.assert_allclose(1 / (1 + np.exp(-made[:, 4])), upstream[0, :, 4], rtol=0, atol=1e-4)


@needs_weights
def test_the_export_computes_what_the_network_does_in_any_batch() -> None:
    import onnx
    import onnxruntime

    from training.export import difference, written
    from training.network import settle, trainable

    network = trainable(WEIGHTS, class_count=3)
    settle(network, _images(4))
    model = written(network, onnx.load(WEIGHTS))
    assert difference(network, model) < 1e-3
    session = onnxruntime.InferenceSession(model.SerializeToString())
    (three,) = session.run(None, {"images": _images(3).numpy()})
    assert three.shape == (3, 3549, 8)


def test_the_loss_falls_to_the_box_that_is_meant() -> None:
    """Raw numbers trained by themselves: after a hundred steps the best cell says the box and its class."""
    from training.assign import cells_of, decode
    from training.loss import Truth, loss_of

    cells = cells_of(96, 96)
    raw = torch.zeros(1, len(cells.stride_px), 8)
    raw[..., 4:] = -3
    raw.requires_grad_()
    truth = Truth(boxes_px=np.array([[20, 30, 80, 50]], np.float32), classes=np.array([1]))
    optimiser = torch.optim.Adam([raw], lr=0.1)
    losses = []
    for _ in range(120):
        loss = loss_of(raw, [truth], cells)
        optimiser.zero_grad()
        loss.total.backward()
        optimiser.step()
        losses.append(float(loss.total))
    assert losses[-1] < 0.2 * losses[0]
    said = raw.detach().numpy()[0]
    best = int(np.argmax(said[:, 4]))
    np.testing.assert_allclose(decode(said[:, :4], cells)[best], truth.boxes_px[0], rtol=0, atol=3)  # px
    assert int(np.argmax(said[best, 5:])) == 1


def test_a_picture_without_defects_asks_for_silence() -> None:
    from training.assign import cells_of
    from training.loss import Truth, loss_of

    cells = cells_of(96, 96)
    nothing = Truth(boxes_px=np.zeros((0, 4), np.float32), classes=np.zeros(0, np.int64))
    quiet, loud = torch.full((1, len(cells.stride_px), 8), -8.0), torch.full((1, len(cells.stride_px), 8), 2.0)
    assert float(loss_of(quiet, [nothing], cells).total) < 0.1 < float(loss_of(loud, [nothing], cells).total)
