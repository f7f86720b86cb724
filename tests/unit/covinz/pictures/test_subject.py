"""What is laid where before it is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from covinz.pictures import panels, view
from covinz.pictures.joining import joinings
from covinz.pictures.map_3d import floor_of
from covinz.pictures.subject import subject_of
from tests.runs import Walks, made_up_run


def test_with_ground_truth_odometry_starts_at_the_truth_and_the_map_lies_on_it() -> None:
    walks = Walks(agents=3)
    subject = subject_of(made_up_run(walks))
    assert subject.aligned
    for track in subject.tracks:
        assert track.before_m[0] == pytest.approx(track.true_m[0])
        drift_m = np.linalg.norm(track.before_m - track.true_m, axis=1)
        assert drift_m[-1] > 10 * drift_m[1]
        # The made-up map's own noise is 0.004 of the world's size along each axis.
        off_m = np.linalg.norm(track.after_m - track.true_m, axis=1)
        assert np.sqrt(np.mean(off_m**2)) < 2.0 * 0.004 * np.sqrt(3) * walks.size_m


def test_a_robot_without_drift_stays_on_the_truth() -> None:
    (track,) = subject_of(made_up_run(Walks(agents=1, drift=0.0))).tracks
    assert np.allclose(track.before_m, track.true_m, atol=1e-9)


def test_without_ground_truth_odometry_starts_at_the_origin_in_the_directions_of_the_map() -> None:
    run = made_up_run(Walks(agents=2, drift=0.0, truth=False))
    subject = subject_of(run)
    assert not subject.aligned
    for track in subject.tracks:
        assert np.array_equal(track.before_m[0], np.zeros(3))
        assert np.isnan(track.true_m).all()
        # Turned by the noise of the map's first pose only.
        assert np.allclose(track.before_m, track.after_m - track.after_m[0], atol=0.6)


def test_the_largest_map_comes_first_and_loops_know_their_kind() -> None:
    subject = subject_of(made_up_run(Walks(agents=5, maps=2, keyframes=30)))
    assert [found.num_keyframes for found in subject.maps] == [90, 60]
    first = subject.maps[0]
    assert first.agents == ["agent0", "agent2", "agent4"]
    assert first.inter.any() and not first.inter.all()
    places = np.concatenate([track.after_m for track in first.tracks])
    index = np.concatenate([track.keyframes for track in first.tracks])
    at = dict(zip(index.tolist(), places, strict=True))
    for number, (cand, query) in enumerate(zip(first.loops.cand, first.loops.query, strict=True)):
        assert np.array_equal(first.loop_ends_m[number, 0], at[int(cand)])
        assert np.array_equal(first.loop_ends_m[number, 1], at[int(query)])


def test_the_first_meeting_is_the_first_loop_between_robots_in_the_log() -> None:
    (found,) = subject_of(made_up_run(Walks(agents=2))).maps
    in_log = np.maximum(found.loops.cand, found.loops.query)[found.inter]
    met = joinings(found)
    assert sorted(met) == [0, 1]
    for number, track in enumerate(found.tracks):
        seconds = met[number].stamp_ns / 1e9
        # Two robots take turns in the log, a keyframe a second.
        assert seconds == (in_log.min() - number) // 2
        assert met[number].partner == found.agents[1 - number]
        assert track.agent != met[number].partner


def test_robots_in_maps_of_their_own_never_met() -> None:
    subject = subject_of(made_up_run(Walks(agents=2, maps=2)))
    assert [joinings(found) for found in subject.maps] == [{}, {}]


def test_up_is_z_where_it_is_known_and_else_where_nothing_moves() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (200, 3)) * [4.0, 0.1, 2.0]
    R = view.upright(points, z_is_up=False)
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1.0)
    # A camera's frame: y is down.
    assert R[2] == pytest.approx([0, -1, 0], abs=0.05)
    assert np.abs(R[0]) == pytest.approx([1, 0, 0], abs=0.05)
    assert np.array_equal(view.upright(points, z_is_up=True), np.eye(3))


def test_a_tall_world_is_turned_to_lie() -> None:
    points = np.random.default_rng(3).uniform(-1, 1, (200, 3)) * [2.0, 5.0, 0.1]
    spans = np.ptp(points @ view.from_above(view.upright(points, z_is_up=True)), axis=0)
    assert spans[0] > 2 * spans[1]


@pytest.mark.parametrize(
    ("limit_m", "length_m", "words"),
    [(0.0031, 0.002, "2 mm"), (0.31, 0.2, "20 cm"), (5.0, 5.0, "5 m"), (2900.0, 2000.0, "2 km")],
)
def test_scale_bars_have_round_lengths(limit_m: float, length_m: float, words: str) -> None:
    assert view.nice_length(limit_m) == pytest.approx(length_m)
    assert view.metres(view.nice_length(limit_m)) == words


def test_points_that_coincide_still_have_a_box() -> None:
    box = view.box_of([np.zeros((3, 2))])
    assert box.right > box.left and box.top > box.bottom


def test_what_shows_the_world_shows_the_same_of_it() -> None:
    subject = subject_of(made_up_run(Walks(agents=4, maps=2, drift=0.1)))
    shown = panels.panels_of(subject, view.from_above)
    assert [panel.in_world for panel in shown] == [True, True, True]
    boxes = panels.boxes(shown, [[]] * 3)
    assert boxes[0] == boxes[1] == boxes[2]
    for panel, box in zip(shown, boxes, strict=True):
        points = np.concatenate(panel.drawn)
        assert (points > [box.left, box.bottom]).all()
        assert (points < [box.right, box.top]).all()


def test_robots_that_know_nothing_of_each_other_start_at_one_point_to_the_right() -> None:
    subject = subject_of(made_up_run(Walks(agents=3, drift=0.0)))
    before = panels.panels_of(subject, view.from_above, show_drift=False)[0]
    assert not before.in_world
    for path_m in before.paths_m:
        assert path_m[0] == pytest.approx(np.zeros(3), abs=1e-12)
    for path in before.drawn:
        away_m = np.linalg.norm(path, axis=1)
        first = path[int(np.argmax(away_m > 0.05 * away_m.max()))]
        assert first[0] > 0
        assert first[1] == pytest.approx(0.0, abs=1e-9)
    # Nobody's path changes its shape.
    for path_m, track in zip(before.paths_m, subject.tracks, strict=True):
        steps, own = (np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (path_m, track.before_m))
        assert np.allclose(steps, own)


def test_a_plan_is_seen_whole_unless_it_is_much_larger_than_the_paths() -> None:
    subject = subject_of(made_up_run(Walks(agents=2, drift=0.0)))
    shown = panels.panels_of(subject, view.from_above)
    near, far = (np.array([[-s, -s], [s, s]]) for s in (9.0, 900.0))
    assert panels.boxes(shown, [[near]] * 2)[0].left < -9.0
    assert panels.boxes(shown, [[far]] * 2) == panels.boxes(shown, [[]] * 2)


def test_the_floor_lies_at_zero_of_a_plan_and_else_below_the_map() -> None:
    for plan, drift in ((True, 0.0), (False, 0.2)):
        subject = subject_of(made_up_run(Walks(agents=2, drift=drift, plan=plan)))
        shown = panels.panels_of(subject, view.from_the_side)
        floor = floor_of(shown, subject.plan)
        lowest = min(float(track.after_m[:, 2].min()) for track in subject.tracks)
        assert floor.up == 0.0 if plan else lowest - 2.0 < floor.up < lowest
        grid = floor.grid()
        assert len(grid) >= 10
        assert (grid[..., :2] >= floor.low).all() and (grid[..., :2] <= floor.high).all()
        assert (grid[..., 2] == floor.up).all()
