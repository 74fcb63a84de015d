"""Policies are found by name; one that is broken says so and hides no other."""

import pytest

from softarm.policies.base import Policy, PolicyError, PolicySpec
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.policies.registry import available, load
from softarm.schemas.config import Policy as Configured

GOOD = """
    import numpy as np
    from softarm.policies.base import PolicySpec

    class Wave:
        spec = PolicySpec(name="whatever", description="swings to and fro")
        def __init__(self, speed: float = 0.5):
            self.speed = speed
        def reset(self):
            self.speed = abs(self.speed)
        def step(self, observation, goal):
            self.speed = -self.speed
            return np.array([self.speed, 0.0])
"""


def test_built_in_policies_are_listed_with_a_description():
    entries = available()
    assert {"hold", "pid", "onnx"} <= entries.keys()
    assert entries["pid"].error is None
    assert "PID" in entries["pid"].description
    assert isinstance(load("hold"), Policy)
    assert load("pid").spec.name == "pid"


def test_onnx_without_a_model_names_the_missing_option():
    assert "needs the option model" in available()["onnx"].error
    with pytest.raises(PolicyError, match="policy 'onnx': plugin 'onnx' needs the option model"):
        load("onnx")


def test_an_installed_plugin_has_the_name_it_was_chosen_by(install):
    install("wavy", GOOD, wave="Wave")
    assert available()["wave"].description == "swings to and fro"
    assert load("wave").spec == PolicySpec(name="wave", description="swings to and fro")


def test_policies_of_the_configuration_take_precedence(install):
    install("wavy", GOOD, wave="Wave")
    configured = {
        "fast": Configured(plugin="wave", options={"speed": 0.9}),
        "pid": Configured(plugin="pid", options={"kp_y": 2.0}),
    }
    assert available(configured)["pid"].options == {"kp_y": 2.0}
    fast = load("fast", configured)
    assert fast.speed == 0.9
    assert fast.spec.name == "fast"
    assert load("wave", configured).speed == 0.5


def test_the_configuration_names_a_model_file(write_model):
    path = write_model()
    configured = {"mine": Configured(plugin="onnx", options={"model": str(path)})}
    entry = available(configured)["mine"]
    assert entry.spec.trained.target_z_m == (0.55, 0.7)
    policy = load("mine", configured)
    assert isinstance(policy, OnnxPolicy)
    assert policy.spec == entry.spec
    assert policy.spec.name == "mine"


def test_shipped_models_are_chosen_by_their_stem(write_model, tmp_path, monkeypatch):
    write_model("lob.onnx")
    (tmp_path / "torn.onnx").write_bytes(b"half")
    monkeypatch.setattr("softarm.policies.registry.MODELS", tmp_path)
    monkeypatch.setattr("softarm.policies.onnx_policy.MODELS", tmp_path)
    entries = available()
    assert entries["lob"].plugin == "onnx"
    assert load("lob").spec.name == "lob"
    assert "not an ONNX model" in entries["torn"].error
    assert entries["torn"].description.startswith("cannot be used: ")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import no_such_module_anywhere", "ModuleNotFoundError: No module named 'no_such_module_anywhere'"),
        ("raise SystemExit('torn')", "SystemExit: torn"),
        ("Other = 1", "AttributeError"),
        ("class Broken: pass", "plugin 'broken' lacks a class attribute `spec`"),
    ],
)
def test_a_plugin_that_fails_is_listed_with_its_error_and_hides_no_other(install, source, message):
    install("torn", source, broken="Broken")
    install("wavy", GOOD, wave="Wave")
    entries = available()
    assert message in entries["broken"].error
    assert entries["wave"].error is None
    assert entries["pid"].error is None
    with pytest.raises(PolicyError, match=r"policy 'broken': .*; available: excite, hold, .*pid.*, wave"):
        load("broken")


def test_a_plugin_whose_constructor_fails_is_reported_with_its_message(install):
    source = GOOD.replace("self.speed = speed", "raise RuntimeError('out of coffee')")
    install("wavy", source, wave="Wave")
    with pytest.raises(PolicyError, match="policy 'wave': RuntimeError: out of coffee; available: "):
        load("wave")


def test_a_plugin_without_step_is_no_policy(install):
    install("wavy", GOOD.replace("def step", "def stop"), wave="Wave")
    with pytest.raises(PolicyError, match="policy 'wave': it lacks spec, reset or step"):
        load("wave")


def test_an_unknown_name_is_refused_with_the_nearest_and_all_names():
    with pytest.raises(PolicyError, match=r"no policy 'hodl'; did you mean 'hold'\? available: excite, hold, .*pid"):
        load("hodl")
    with pytest.raises(PolicyError, match=r"no policy 'xyzzy'; available: excite, hold, .*pid"):
        load("xyzzy")


@pytest.mark.parametrize(
    ("configured", "message"),
    [
        (Configured(plugin="pdi"), r"no plugin 'pdi'; did you mean 'pid'\? \(installed: excite, .*onnx, pid"),
        (
            Configured(plugin="pid", options={"kpy": 1}),
            r"plugin 'pid' has no option 'kpy'; did you mean 'kp_y'\? \(known: kp_y, ",
        ),
        (Configured(plugin="hold", options={"rest_pressure_kpa": "much"}), "TypeError: "),
    ],
)
def test_a_mistake_in_the_configuration_is_explained_when_the_policy_is_loaded(configured, message):
    with pytest.raises(PolicyError, match=f"policy 'mine': .*{message}"):
        load("mine", {"mine": configured})
