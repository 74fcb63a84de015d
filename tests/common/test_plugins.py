"""Plug-ins of other packages are checked before their use."""

import re
import shutil
import sys
from pathlib import Path

import pytest

from softarm.common import plugins
from softarm.common.plugins import PluginError


class Takes:
    def __init__(self, port: int, rate_hz: float = 100.0):
        pass


def test_without_plugins_an_unknown_name_is_reported():
    with pytest.raises(PluginError, match=r"no source 'udp' \(installed: none\)"):
        plugins.find("source", "udp", {})


def test_a_plugin_is_found_as_soon_as_it_is_installed_and_until_it_is_removed(install, tmp_path):
    assert "late" not in plugins.installed("softarm.tests")
    install("late_plugin", "def make(): return 5\n", "softarm.tests", late="make")
    assert plugins.installed("softarm.tests")["late"]()() == 5
    shutil.rmtree(tmp_path / "late_plugin-1.0.dist-info")
    assert "late" not in plugins.installed("softarm.tests")


def test_a_plugin_in_the_current_folder_is_found_where_the_path_has_an_empty_entry(install, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    assert "near" not in plugins.installed("softarm.tests")
    install("near_plugin", "def make(): return 6\n", "softarm.tests", near="make")
    sys.path.remove(str(tmp_path))
    assert plugins.installed("softarm.tests")["near"]()() == 6


def test_options_are_checked_before_anything_is_made():
    plugins.check_options("source", "udp", Takes, {"port": 1})
    with pytest.raises(PluginError, match="source 'udp' needs the option port"):
        plugins.check_options("source", "udp", Takes, {})
    plugins.check_options("source", "any", lambda **options: options, {"whatever": 1})


@pytest.mark.parametrize(("interface", "fits"), [(None, True), (1, True), (2, True), (3, False)])
def test_a_plugin_for_a_newer_interface_is_refused_and_an_older_one_is_not(interface, fits):
    plugin = type("Plugin", (), {} if interface is None else {"interface": interface})
    if fits:
        plugins.check_interface("policy", "mine", plugin, 2)
    else:
        with pytest.raises(PluginError, match="'mine' was written for interface 3, this software speaks 2: update"):
            plugins.check_interface("policy", "mine", plugin, 2)


@pytest.mark.parametrize("interface", ["1", 0, 1.0, True])
def test_an_invalid_interface_version_is_reported(interface):
    with pytest.raises(PluginError, match="allowed is an integer from 1 to 2"):
        plugins.check_interface("policy", "mine", type("Plugin", (), {"interface": interface}), 2)


def test_an_error_is_formatted_as_one_line():
    assert plugins.said(ValueError("one\n  two")) == "ValueError: one two"
    assert plugins.said(PluginError("it lacks a wheel")) == "it lacks a wheel"


def test_the_page_lists_the_supported_interfaces():
    pytest.importorskip("torch")
    from softarm.drivers.mocap import source
    from softarm.policies import base
    from softarm.training.task import registry

    page = (Path(__file__).parents[2] / "docs" / "policies" / "plugins.md").read_text(encoding="utf-8")
    (spoken,) = re.findall(r"three interfaces has a number, now (\d+)", page)
    assert {base.INTERFACE, registry.INTERFACE, source.INTERFACE} == {int(spoken)}
    assert all(f"`{each.GROUP}`" in page for each in (base, registry, source))
