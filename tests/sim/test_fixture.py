from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.geometry import Pose, rotation_z
from dynaforge.sim import BodySpec, Condition, Drive, FixtureSpec, Launch, Placement, SceneSpec, SimScene, Spring

SLIDER = """<?xml version="1.0"?>
<robot name="slider">
  <link name="base">
    <inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="base"/><child link="plate"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="200" velocity="2"/>
  </joint>
  <link name="plate">
    <inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.01"/><geometry><box size="0.2 0.2 {thickness}"/></geometry></collision>
  </link>
  <joint name="press" type="prismatic">
    <parent link="plate"/><child link="button"/><origin xyz="0 0 0.02"/><axis xyz="0 0 1"/>
    <limit lower="-0.008" upper="0" effort="50" velocity="1"/>
  </joint>
  <link name="button">
    <inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.005"/><geometry><cylinder radius="0.03" length="0.01"/></geometry></collision>
  </link>
</robot>
"""
BOX = """<?xml version="1.0"?>
<robot name="weight">
  <link name="weight">
    <inertial><mass value="1"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.04 0.04 0.04"/></geometry></collision>
  </link>
</robot>
"""
CONDITION = Condition("test", 0, 0.5, {})
BASE = Pose(rotation_z(0.5), np.array((0.5, 0.3, 0.05)))
SWING = Drive(start=0.1, rate=0.05, amplitude=0.08, frequency=3.0, phase=0.4)


@pytest.fixture
def spec(tmp_path: Path) -> SceneSpec:
    files = []
    for k, thickness in enumerate((0.02, 0.03)):
        (tmp_path / f"slider{k}.urdf").write_text(SLIDER.format(thickness=thickness))
        files.append(str(tmp_path / f"slider{k}.urdf"))
    (tmp_path / "box.urdf").write_text(BOX)
    fixture = FixtureSpec("slider", tuple(files), "plate", driven=("slide",))
    return SceneSpec(
        bodies=(BodySpec("weight", str(tmp_path / "box.urdf")),), launch=lambda condition: start(), fixtures=(fixture,)
    )


def start(drive: Drive = SWING, *, weight: tuple[float, float, float] = (1.5, 0.0, 0.02), variant: int = 0):
    return {
        "slider": Placement(BASE, {"slide": drive}, variant),
        "weight": Launch(Pose(np.eye(3), np.array(weight)), np.zeros(3), np.zeros(3), 1.0),
    }


def ran(spec: SceneSpec, steps: int) -> Iterator[tuple[SimScene, object]]:
    scene = SimScene(spec)
    yield scene, scene.reset(CONDITION)
    for _ in range(steps):
        yield scene, scene.step(scene.robot.q_ready, 0.08)
    scene.close()


def test_a_drive_moves_its_joint_as_it_says(spec: SceneSpec) -> None:
    axis = BASE.rotation[:, 0]
    for _, state in ran(spec, 60):
        plate = state.objects["slider"]
        np.testing.assert_allclose(plate.pose.position, BASE.position + SWING.position(state.time) * axis, atol=2e-4)
        assert abs(plate.velocity @ axis - SWING.speed(state.time)) < 0.03  # the mean speed of the last control step
        np.testing.assert_allclose(plate.pose.rotation, BASE.rotation, atol=1e-6)


def test_the_speed_of_a_drive_is_the_derivative_of_its_position() -> None:
    assert SWING.position(0.0) == SWING.start
    for t in (0.0, 0.3, 2.0):
        numeric = (SWING.position(t + 1e-6) - SWING.position(t - 1e-6)) / 2e-6
        assert SWING.speed(t) == pytest.approx(numeric, abs=1e-7)


def test_what_lies_on_a_fixture_is_carried_only_by_friction(spec: SceneSpec) -> None:
    gentle, fierce = Drive(amplitude=0.1, frequency=3.0), Drive(amplitude=0.1, frequency=20.0)  # 0.9 and 40 m/s^2
    left = []
    for drive in (gentle, fierce):
        states = [
            state for _, state in ran(replace(spec, launch=lambda _, d=drive: start(d, weight=(0.5, 0.3, 0.0905))), 60)
        ]
        offsets = [s.objects["weight"].pose.position - s.objects["slider"].pose.position for s in states]
        left.append(float(np.ptp(offsets, axis=0)[:2].max()))
    assert left[0] < 0.01 < left[1]


def test_a_spring_holds_its_button_until_something_heavy_presses_it(spec: SceneSpec) -> None:
    sprung = replace(spec.fixtures[0], link="button", spring=Spring("press", 3.0))
    top = BASE.apply(np.array((0.0, 0.0, 0.042)))
    for weight, pressed in (((1.5, 0.0, 0.02), False), (tuple(top), True)):
        changed = replace(spec, fixtures=(sprung,), launch=lambda _, at=weight: start(Drive(), weight=at))
        *_, (_, state) = ran(changed, 30)
        assert (state.pressed["slider"] > 0.006) is pressed  # 1 kg against 3 N
        assert state.pressed["slider"] < 0.009, "the joint's limit holds"


def test_a_condition_chooses_the_variant_and_the_others_wait(spec: SceneSpec) -> None:
    for variant in (0, 1, 0):
        scene = SimScene(replace(spec, launch=lambda _, v=variant: start(variant=v)))
        scene.reset(CONDITION)
        fixture = scene._bullet.fixtures["slider"]
        assert fixture.body == fixture.variants[variant]
        heights = [scene._bullet.client.getBasePositionAndOrientation(body)[0][2] for body in fixture.variants]
        assert [height < 1.0 for height in heights] == [k == variant for k in (0, 1)]
        scene.close()


def test_the_same_condition_repeats_after_another_variant_and_contact(spec: SceneSpec) -> None:
    chosen = {"variant": 0}
    scene = SimScene(replace(spec, launch=lambda _: start(weight=(0.5, 0.3, 0.0905), **chosen)))

    def trace() -> bytes:
        scene.reset(CONDITION)
        states = [scene.step(scene.robot.q_ready, 0.08) for _ in range(20)]
        return b"".join(s.objects[name].pose.position.tobytes() for s in states for name in s.objects)

    first = trace()
    chosen["variant"] = 1
    assert trace() != first
    chosen["variant"] = 0
    assert trace() == first
    scene.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"driven": ("slyde",)}, r"has no joint 'slyde'; it has \['press', 'slide'\]"),
        ({"link": "lid"}, "has no link 'lid'"),
    ],
)
def test_what_a_urdf_lacks_is_named(spec: SceneSpec, change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SimScene(replace(spec, fixtures=(replace(spec.fixtures[0], **change),)))


@pytest.mark.parametrize(
    ("placement", "message"),
    [
        (Placement(BASE, {}, 2), "has no variant 2; it has 2"),
        (Placement(BASE, {"press": Drive()}), r"drives \('slide',\), not \['press'\]"),
    ],
)
def test_a_placement_that_does_not_fit_is_named(spec: SceneSpec, placement: Placement, message: str) -> None:
    scene = SimScene(replace(spec, launch=lambda _: {"slider": placement}))
    with pytest.raises(ValueError, match=message):
        scene.reset(CONDITION)
    scene.close()


def test_a_root_link_with_a_frame_of_its_own_is_refused(tmp_path: Path) -> None:
    (tmp_path / "off.urdf").write_text(BOX.replace("<inertial>", '<inertial><origin xyz="0 0 0.01"/>'))
    spec = SceneSpec(bodies=(BodySpec("weight", str(tmp_path / "off.urdf")),), launch=lambda _: {})
    with pytest.raises(ValueError, match="inertial origin of the root link must be 0 0 0"):
        SimScene(spec)


def test_a_fixture_that_cannot_move_is_where_the_latest_condition_places_it(spec: SceneSpec, tmp_path: Path) -> None:
    rack = FixtureSpec("rack", str(tmp_path / "box.urdf"), "weight")

    def launch(condition: Condition) -> dict[str, Launch | Placement]:
        return {**start(), "rack": Placement(Pose(np.eye(3), np.array((0.5, condition.values["y"], 0.02))))}

    scene = SimScene(replace(spec, fixtures=(*spec.fixtures, rack), launch=launch))
    for y in (0.1, -0.2):
        state = scene.reset(Condition("test", 0, 0.5, {"y": y}))
        assert state.objects["rack"].pose.position == pytest.approx((0.5, y, 0.02))
        after = scene.step(scene.robot.q_ready, 0.08)
        assert after.objects["rack"] is state.objects["rack"]  # Bullet was not asked again
    scene.close()
