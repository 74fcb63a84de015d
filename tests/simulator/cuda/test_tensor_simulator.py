"""The simulator in a torch tensor equals the CPU's within float32, on a graphics card where there is one."""

import numpy as np
import pytest
import torch

from softarm.schemas.model import Model
from softarm.simulator.cuda import stepper
from softarm.simulator.cuda.simulator import TensorSimulator
from softarm.simulator.effects import exemplars
from softarm.simulator.simulator import Simulator

ROBOTS = 40
card = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")
DEVICES = ["cpu", pytest.param("cuda", marks=card)]
MODELS = [Model(), Model(effects=exemplars())]


def _starts(rng):
    cart, angles = rng.uniform(-0.2, 0.2, ROBOTS), rng.uniform(-0.2, 0.2, (ROBOTS, 5))
    return [each.astype(np.float32) for each in (cart, angles, rng.uniform(0, 20, ROBOTS))]


def _fly(one, other, device, rng, steps=60):
    for _ in range(steps):
        command = [rng.uniform(-1, 1, ROBOTS).astype(np.float32), rng.uniform(0, 20, ROBOTS).astype(np.float32)]
        one.step(*command)
        other.step(*(torch.from_numpy(each).to(device) for each in command))
    np.testing.assert_allclose(other.tip_m().cpu(), one.tip_m(), atol=2e-5)
    np.testing.assert_allclose(other.tip_velocity_m_s().cpu(), one.tip_velocity_m_s(), atol=2e-4)
    np.testing.assert_allclose(other.cart_position_m.cpu(), one.cart_position_m, atol=1e-5)
    np.testing.assert_allclose(other.pressure_kpa.cpu(), one.pressure_kpa, atol=1e-4)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("model", MODELS, ids=["seed", "every effect"])
def test_trajectories_equal_those_of_the_cpu(model, device):
    rng = np.random.default_rng(1)
    one, other = Simulator(model, ROBOTS), TensorSimulator(model, ROBOTS, device=device)
    cart, angles, pressure = _starts(rng)
    one.reset(cart_position_m=cart, joint_angles_rad=angles, pressure_kpa=pressure)
    tensors = [torch.from_numpy(each).to(device) for each in (cart, angles, pressure)]
    other.reset(torch.ones(ROBOTS, dtype=torch.bool, device=device), *tensors)
    np.testing.assert_allclose(other.tip_m().cpu(), one.tip_m(), atol=1e-6)
    _fly(one, other, device, rng)


@pytest.mark.parametrize("device", DEVICES)
def test_robots_take_the_parameters_of_their_variant(device):
    rng = np.random.default_rng(2)
    lag, mass = np.array([0.0, 0.05, 0.1]), np.array([0.1, 0.0, 0.05])
    robot = np.arange(ROBOTS)
    variants = {"rail.lag.time": lag, "arm.payload.mass": mass}
    other = TensorSimulator(None, ROBOTS, overrides=variants, device=device)
    again = robot % 2 == 0  # these become another variant
    chosen = np.where(again, (robot + 1) % 3, robot % 3)
    one = Simulator(robots=ROBOTS, overrides={path: values[chosen] for path, values in variants.items()})
    mask = torch.from_numpy(again).to(device)
    other.reset(mask, variant=torch.from_numpy((robot + 1) % 3).to(device))
    _fly(one, other, device, rng)


def test_a_reset_leaves_other_robots_alone():
    rng = np.random.default_rng(3)
    one, other = Simulator(robots=ROBOTS), TensorSimulator(robots=ROBOTS, device="cpu")
    _fly(one, other, "cpu", rng, steps=5)
    some, (cart, angles, pressure) = rng.random(ROBOTS) < 0.5, _starts(rng)
    one.reset(robots=some, cart_position_m=cart, joint_angles_rad=angles, pressure_kpa=pressure)
    other.reset(*map(torch.from_numpy, (some, cart, angles, pressure)))
    _fly(one, other, "cpu", rng, steps=30)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS, ids=["seed", "every effect"])
def test_the_kernel_compiles_for_a_card(model, monkeypatch):
    pytest.importorskip("numba_cuda", reason="needs numba-cuda")
    from numba import types
    from numba.cuda import compiler, dispatcher

    class Card:
        compute_capability = (9, 0)

    monkeypatch.setattr(dispatcher, "get_current_device", Card)
    active = TensorSimulator(model, device="cpu").active
    signature = types.void(types.float32[:, ::1], types.int32, types.int32, types.float32)
    ptx, _ = compiler.compile_ptx(stepper.entries(5, active)[0], signature, cc=(9, 0))
    assert "st.global.f32" in ptx


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "numba_cuda", None)
    with pytest.raises(ValueError, match=r"install softarm\[cuda\]"):
        stepper.numba_cuda()
