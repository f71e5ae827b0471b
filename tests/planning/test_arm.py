"""The chain of a URDF: forward as the simulated UR5 and as yourdfpy have it, inverse within limits."""

import numpy as np
import pytest
import yourdfpy

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.planning import Both, Workspace, read_arm
from handeye_fg.simulate.arms import UR5

LOW, HIGH = -2.5, 2.8


def urdf(
    path,
    *,
    joint_type="revolute",
    limit=f'<limit lower="{LOW}" upper="{HIGH}" effort="1" velocity="1"/>',
):
    """The UR5 by its Denavit-Hartenberg parameters: a link's pose stands in the next joint's origin."""
    joints = ['<link name="world"/><link name="l0"/><link name="tool"/>']
    joints.append(
        '<joint name="stand" type="fixed"><parent link="world"/><child link="l0"/>'
        '<origin xyz="0.1 0.2 0.3" rpy="0 0 0.5"/></joint>'
    )
    before = "0 0 0"
    turned = "0 0 0"
    for i in range(6):
        joints.append(f'<link name="l{i + 1}"/>')
        joints.append(
            f'<joint name="q{i}" type="{joint_type}"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{before}" rpy="{turned}"/><axis xyz="0 0 1"/>{limit}</joint>'
        )
        before, turned = f"{UR5.a[i]} 0 {UR5.d[i]}", f"{UR5.alpha[i]} 0 0"
    joints.append(
        '<joint name="flange" type="fixed"><parent link="l6"/><child link="tool"/>'
        f'<origin xyz="{before}" rpy="{turned}"/></joint>'
    )
    path.write_text(f'<robot name="ur5">{"".join(joints)}</robot>', encoding="utf-8")
    return path


@pytest.fixture
def file(tmp_path):
    return urdf(tmp_path / "ur5.urdf")


def draws(count):
    return np.random.default_rng(1).uniform(LOW, HIGH, (count, 6))


def test_forward(file):
    joints = draws(20)
    np.testing.assert_allclose(
        read_arm(file, "tool", "l0").base_T_gripper(joints), UR5.base_T_gripper(joints), atol=1e-12
    )
    theirs = yourdfpy.URDF.load(str(file), load_meshes=False)
    for row, ours in zip(joints, read_arm(file, "tool").base_T_gripper(joints), strict=True):
        theirs.update_cfg(row)
        np.testing.assert_allclose(theirs.get_transform("tool", "world"), ours, atol=1e-9)


def test_poses_of_joints_within_limits_are_reached_and_no_others(file):
    arm = read_arm(file, "tool", "l0")
    within = UR5.base_T_gripper(draws(20))
    assert np.mean(arm.reachable(within)) >= 0.85  # the search may miss some
    far = within[:4].copy()
    far[:, :3, 3] *= 1.2 / np.linalg.norm(far[:, :3, 3], axis=1, keepdims=True)
    assert not arm.reachable(far).any()
    both = Both((arm, Workspace((-2.0, -2.0, 0.0), (2.0, 2.0, 2.0))))
    assert not (both.reachable(within) & (within[:, 2, 3] < 0.0)).any()
    assert len(both.reachable(within[:0])) == 0


def test_limits_are_kept(tmp_path):
    narrow = urdf(
        tmp_path / "narrow.urdf", limit='<limit lower="0.5" upper="0.9" effort="1" velocity="1"/>'
    )
    arm = read_arm(narrow, "tool", "l0")
    rng = np.random.default_rng(2)
    assert arm.reachable(UR5.base_T_gripper(rng.uniform(0.5, 0.9, (4, 6)))).all()
    joints = rng.uniform(0.5, 0.9, (4, 6))
    joints[:, 0] += 0.8
    beyond = UR5.base_T_gripper(joints)
    assert not arm.reachable(beyond).any()


def test_sliding_and_endless_joints(tmp_path):
    gantry = tmp_path / "gantry.urdf"
    gantry.write_text(
        '<robot name="g"><link name="a"/><link name="b"/><link name="c"/>'
        '<joint name="x" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="2 0 0"/>'
        '<limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>'
        '<joint name="t" type="continuous"><parent link="b"/><child link="c"/><origin xyz="0 0 1"/>'
        '<axis xyz="0 0 1"/></joint></robot>',
        encoding="utf-8",
    )
    arm = read_arm(gantry, "c")
    (pose,) = arm.base_T_gripper(np.array([[0.3, 0.7]]))
    np.testing.assert_allclose(pose[:3, 3], [0.3, 0.0, 1.0])
    assert frames.rotation_angle(pose[:3, :3]) == pytest.approx(0.7)
    too_far = arm.base_T_gripper(np.array([[0.3, 0.7], [0.6, 0.7]]))
    assert arm.reachable(too_far).tolist() == [True, False]


@pytest.mark.parametrize(
    ("change", "tip", "base", "words"),
    [
        ({}, "hand", None, "no link 'hand'"),
        ({}, "l1", "l4", "no joints lead from 'l4' to 'l1'"),
        ({}, "l0", None, "no joint moves"),
        ({"joint_type": "floating"}, "tool", None, "but must be fixed or one of"),
        ({"limit": ""}, "tool", None, "limits None to None"),
    ],
)
def test_files_that_do_not_serve(tmp_path, change, tip, base, words):
    file = urdf(tmp_path / "bad.urdf", **change)
    with pytest.raises(InputDataError, match=words):
        read_arm(file, tip, base)


def test_no_urdf(tmp_path, monkeypatch):
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot", encoding="utf-8")
    with pytest.raises(InputDataError, match="not its xacro"):
        read_arm(broken, "tool")
    monkeypatch.setitem(__import__("sys").modules, "yourdfpy", None)
    with pytest.raises(InputDataError, match="pip install"):
        read_arm(broken, "tool")


def test_a_workspace_needs_two_corners():
    with pytest.raises(ValueError, match="2 corners"):
        Workspace((0.0, 0.0), (1.0, 1.0))
    with pytest.raises(ValueError, match="2 corners"):
        Workspace((0.0, 0.0, 0.0), (1.0, 1.0, np.nan))
    with pytest.raises(ValueError, match="smaller to the larger"):
        Workspace((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
