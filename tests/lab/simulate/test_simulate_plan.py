"""What is recorded of a walk: faults do what they say, and nothing else."""

from typing import Any

import numpy as np
import pytest
from typed import present

from kinectbench.core.geometry import rigid
from kinectbench.lab.simulate.plan import PlannedFrame, given_trajectory, plan_frames
from kinectbench.lab.simulate.spec import SimulationSpec

FRAMES = 60
POSES = np.stack([rigid(np.eye(3), [0.02 * k, 0.0, 1.0]) for k in range(FRAMES)])


def spec_of(
    faults: dict[str, float] | None = None,
    given: dict[str, str | float] | None = None,
    sensor: dict[str, float] | None = None,
    seed: int = 0,
) -> SimulationSpec:
    sections = {"faults": faults or {}, "given": given or {}, "sensor": sensor or {}}
    return SimulationSpec.model_validate(
        {"seed": seed, "path": {"frames": FRAMES, "rate_hz": 10.0}, **sections}
    )


def planned(**sections: Any) -> tuple[PlannedFrame, ...]:
    return plan_frames(spec_of(**sections), POSES)


def test_without_faults_everything_is_recorded_as_it_was() -> None:
    frames = planned()
    assert [frame.source for frame in frames] == list(range(FRAMES))
    assert [frame.time_s for frame in frames] == [k / 10 for k in range(FRAMES)]
    assert all(frame.stamp_ns == frame.color_stamp_ns == spec_of().stamp_ns(frame.source) for frame in frames)
    assert all(np.array_equal(present(frame.T_world_given), POSES[frame.source]) for frame in frames)
    assert not any(frame.foreign for frame in frames)


def test_dropped_frames_are_missing_and_the_others_keep_their_stamps() -> None:
    frames = planned(faults={"drop_share": 0.3})
    assert 30 < len(frames) < 54
    assert all(frame.stamp_ns == spec_of().stamp_ns(frame.source) for frame in frames)
    assert len(planned(faults={"drop_share": 0.9}, seed=5)) >= 1


def test_wrong_stamps() -> None:
    stamps = np.array([frame.stamp_ns for frame in planned(faults={"stamp_jitter_s": 0.02})])
    off_s = (stamps - [spec_of().stamp_ns(k) for k in range(FRAMES)]) / 1e9
    assert off_s.std() == pytest.approx(0.02, rel=0.3)
    swapped = np.array([frame.stamp_ns for frame in planned(faults={"swapped_stamps": 4})])
    assert (np.diff(swapped) < 0).sum() == 4
    assert sorted(swapped.tolist()) == [spec_of().stamp_ns(k) for k in range(FRAMES)]
    late = planned(sensor={"color_delay_s": 0.016})
    assert {frame.color_stamp_ns - frame.stamp_ns for frame in late} == {16_000_000}


def test_foreign_frames_are_in_the_middle() -> None:
    foreign = [frame.source for frame in planned(faults={"foreign_frames": 4}) if frame.foreign]
    assert foreign == [28, 29, 30, 31]


def test_given_trajectories() -> None:
    assert given_trajectory(spec_of(given={"trajectory": "none"}), POSES) is None
    assert all(frame.T_world_given is None for frame in planned(given={"trajectory": "none"}))
    noisy = present(given_trajectory(spec_of(given={"trajectory": "noisy", "noise_m": 0.005}), POSES))
    assert (noisy - POSES)[:, :3, 3].std() == pytest.approx(0.005, rel=0.15)
    drifting = present(
        given_trajectory(spec_of(given={"trajectory": "drifting", "drift_m_per_m": 0.02}), POSES)
    )
    off_m = np.linalg.norm((drifting - POSES)[:, :3, 3], axis=1)
    assert off_m[0] == 0
    # 1.18 m of path: 2 % of it, a little changed by the turn that comes along.
    assert off_m[-1] == pytest.approx(0.02 * 1.18, rel=0.3)
    assert np.allclose(drifting[:, :3, :3] @ drifting[:, :3, :3].transpose(0, 2, 1), np.eye(3))
    jumped = present(given_trajectory(spec_of(faults={"jump_m": 0.1}), POSES)) - POSES
    assert np.allclose(np.linalg.norm(jumped[:, :3, 3], axis=1), [0.0] * 30 + [0.1] * 30)
