"""Shapes of bodies: points on the surfaces of their geoms."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.rigs.mjcf.shapes import ROD, Shapes

KINDS = {
    "sphere": '<geom type="sphere" size=".1"/>',
    "capsule": '<geom type="capsule" size=".05 .2"/>',
    "cylinder": '<geom type="cylinder" size=".1 .2"/>',
    "ellipsoid": '<geom type="ellipsoid" size=".1 .2 .05"/>',
    "box": '<geom type="box" size=".1 .2 .05"/>',
    "mesh": '<geom type="mesh" mesh="wedge"/>',
}
WEDGE = '<asset><mesh name="wedge" vertex="0 0 0  .3 0 0  0 .2 0  0 0 .1  .3 0 .1"/></asset>'


def model(geoms, base=""):
    """Return a model of a body on a slanted hinge that carries these geoms."""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco>{WEDGE}<worldbody><geom type="plane" size="1 1 .1"/><body name="base" pos="0 0 1">{base}'
        f'<body name="arm" pos=".1 .2 .3" euler="20 30 40"><joint axis="1 2 3"/>{geoms}'
        '<inertial pos="0 0 -.2" mass="1" diaginertia=".01 .01 .01"/></body></body></worldbody></mujoco>'
    )


def points(of, position=0.0):
    """Return the points of each geom in one pose, [G, P, 3]."""
    return Shapes(mujoco, of).points(np.array([[position]]))[0]


@pytest.mark.parametrize("kind", KINDS)
def test_points_are_on_the_surface_and_reach_its_bounds(kind):
    of = model(KINDS[kind].replace("<geom", '<geom pos=".3 .1 0" euler="10 20 30"'))
    data = mujoco.MjData(of)
    data.qpos[:] = 0.7
    mujoco.mj_forward(of, data)
    found = points(of, 0.7)[-1]
    geom, turn = of.ngeom - 1, data.geom_xmat[-1].reshape(3, 3)
    own = (found - data.geom_xpos[geom]) @ turn
    centre, half = of.geom_aabb[geom, :3], of.geom_aabb[geom, 3:]
    assert own.min(axis=0) == pytest.approx(centre - half, abs=1e-6)
    assert own.max(axis=0) == pytest.approx(centre + half, abs=1e-6)
    inside = own.mean(axis=0)
    for point in own:
        hit, ray = np.array([-1], np.int32), (point - inside) * [0.999, 0.998, 0.997]  # beside edges and corners
        start = data.geom_xpos[geom] + turn @ (inside + 2 * ray)
        distance = mujoco.mj_ray(of, data, start, -turn @ ray, None, 1, -1, hit, None)
        assert (hit[0], distance) == (geom, pytest.approx(1.0, abs=5e-3))


def test_geoms_that_the_viewer_hides_are_left_out_if_others_are_drawn():
    hidden = '<geom type="box" size=".3 .3 .3" group="3"/>'
    clear = '<geom type="box" size=".3 .3 .3" rgba="1 1 1 0"/>'
    assert points(model(KINDS["sphere"] + hidden + clear)) == pytest.approx(points(model(KINDS["sphere"])))
    assert np.ptp(points(model(hidden))[-1], axis=0).min() > 0.6


def test_the_body_that_carries_a_moving_one_is_drawn_and_the_ground_is_not():
    assert len(points(model(KINDS["sphere"], KINDS["box"]))) == 2


def test_a_body_without_geoms_is_a_rod_to_the_next_one_or_through_its_centre_of_mass():
    of = model("")
    base, arm = points(of)
    assert (base.max(axis=0) + base.min(axis=0)) / 2 == pytest.approx([0.05, 0.1, 1.15], abs=0.01)
    lengths = [np.linalg.norm(each[:, None] - each, axis=-1).max() for each in (base, arm)]
    ends = 2 * ROD * of.stat.extent
    assert lengths == pytest.approx([np.linalg.norm([0.1, 0.2, 0.3]) + ends, 0.4 + ends], rel=0.02)
