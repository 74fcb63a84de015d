"""The fast recurrent layer is an LSTM: values and gradients of torch's own, episodes beginning anywhere."""

import pytest
import torch

from softarm.training.learn import cell, lstm

STEPS, BATCH, INPUTS, SIZE = 7, 5, 6, 24


@pytest.fixture
def reference() -> torch.nn.LSTM:
    torch.manual_seed(0)
    layer = torch.nn.LSTM(INPUTS, SIZE)
    with torch.no_grad():
        layer.bias_hh_l0.zero_()
        for parameter in layer.parameters():
            parameter.mul_(4.0)  # gates well away from the middle
    return layer


def torch_sequence(layer, x, keep, state):
    """The plain way: one step at a time, the state zeroed where an episode begins."""
    h, c = state
    outputs = []
    for t in range(x.shape[0]):
        h, c = h * keep[t, :, None], c * keep[t, :, None]
        out, (h, c) = layer(x[t : t + 1], (h[None], c[None]))
        outputs.append(out[0])
        h, c = h[0], c[0]
    return torch.stack(outputs), (h, c)


def inputs(seed: int = 1):
    generator = torch.Generator().manual_seed(seed)
    x = (3.0 * torch.randn(STEPS, BATCH, INPUTS, generator=generator)).requires_grad_()
    keep = (torch.rand(STEPS, BATCH, generator=generator) > 0.3).float()
    state = (torch.randn(BATCH, SIZE, generator=generator), torch.randn(BATCH, SIZE, generator=generator))
    weight = torch.randn(STEPS, BATCH, SIZE, generator=generator)
    return x, keep, state, weight


def fast(layer, x, keep, state, dtype=torch.float32):
    return lstm.sequence(x, keep, state, layer.weight_ih_l0, layer.weight_hh_l0, layer.bias_ih_l0, dtype)


def _cell(given, fed, cell):
    """Compute what torch's fused cell does, which there is on graphics cards alone."""
    i, f, g, o = (given + fed).chunk(4, dim=1)
    after = f.sigmoid() * cell + i.sigmoid() * g.tanh()
    return o.sigmoid() * after.tanh(), after, None


def of_a_card(layer, x, keep, state):
    """Run the cells of graphics cards, here on the processor."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lstm, "fused_cell", _cell)
        return lstm._step_by_step(x, keep, state, layer.weight_ih_l0, layer.weight_hh_l0, layer.bias_ih_l0)


def gradients(run, layer, *more):
    x, keep, state, weight = inputs()
    wanted = [x, layer.weight_ih_l0, layer.weight_hh_l0, layer.bias_ih_l0]
    return torch.autograd.grad((run(layer, x, keep, state, *more)[0] * weight).sum(), wanted)


@pytest.mark.parametrize("run", [fast, of_a_card])
def test_values_and_last_state_equal_torch(reference, run):
    x, keep, state, _ = inputs()
    expected, (h, c) = torch_sequence(reference, x, keep, state)
    hidden, (last_h, last_c) = run(reference, x, keep, state)
    torch.testing.assert_close(hidden, expected, atol=2e-6, rtol=0)
    torch.testing.assert_close(last_h, h, atol=2e-6, rtol=0)
    torch.testing.assert_close(last_c, c, atol=5e-6, rtol=1e-6)


@pytest.mark.parametrize("run", [fast, of_a_card])
def test_gradients_equal_autograd(reference, run):
    for a, e in zip(gradients(run, reference), gradients(torch_sequence, reference), strict=True):
        torch.testing.assert_close(a, e, atol=1e-5 * float(e.abs().max()), rtol=0)


def test_bfloat16_products_stay_close(reference):
    x, keep, state, _ = inputs()
    exact, _ = fast(reference, x, keep, state)
    rough, _ = fast(reference, x, keep, state, torch.bfloat16)
    assert 0.0 < float((exact - rough).detach().abs().mean()) < 0.02


def test_gradients_through_bfloat16_products_stay_close(reference):
    for r, e in zip(gradients(fast, reference, torch.bfloat16), gradients(fast, reference), strict=True):
        assert 0.0 < float((r - e).norm()) < 0.05 * float(e.norm())


def test_the_input_of_the_next_step_is_rounded_like_in_torch():
    generator = torch.Generator().manual_seed(0)
    pre_activations = 3.0 * torch.randn(64, 4 * SIZE, generator=generator)
    pre_activations[0, :3] = torch.tensor([float("inf"), float("nan"), -0.0])
    zeros, ones = torch.zeros(64, SIZE), torch.ones(64)
    hidden, fed = torch.empty(64, SIZE), torch.empty(64, SIZE, dtype=torch.bfloat16)
    given = (pre_activations, torch.zeros(4 * SIZE), zeros, ones, ones)
    written = (torch.empty(64, 4 * SIZE), torch.empty(64, SIZE), hidden)
    cell.forward(*(each.numpy() for each in given + written), fed.view(torch.uint16).numpy())
    assert torch.isnan(hidden[0]).any()
    torch.testing.assert_close(fed, hidden.to(torch.bfloat16), rtol=0, atol=0, equal_nan=True)


def test_large_pre_activations_saturate_and_stay_finite(reference):
    x, keep, state, _ = inputs()
    x = (1e6 * x).detach().requires_grad_()
    hidden, _ = fast(reference, x, keep, state)
    (gradient,) = torch.autograd.grad(hidden.sum(), [x])
    assert torch.isfinite(hidden).all()
    assert torch.isfinite(gradient).all()


def test_nan_in_the_state_stays_visible(reference):
    x, _, state, _ = inputs()
    x = x.detach()
    x[0, 2] = float("nan")
    hidden, _ = fast(reference, x, torch.ones(STEPS, BATCH), state)
    assert torch.isnan(hidden[-1, 2]).any()
    assert torch.isfinite(hidden[:, [0, 1, 3, 4]]).all()
