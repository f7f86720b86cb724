"""Generated tracks are what they say, and rigs of both rules close their loops."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.loop_figures import Limits, Tally
from benchmarks.rig_neighbours import figures, solve, with_rigs
from benchmarks.rig_tracks import KEYFRAMES, TRACKS, generate
from covinz.codec import encode
from covinz.frames import inverse, rotation_angle

LIMITS = Limits(0.3, float(np.deg2rad(3)))


def test_the_same_seed_gives_the_same_bytes() -> None:
    one, other = (generate(TRACKS["any_room"], 3)[0] for _ in range(2))
    assert [encode(kf) for kf in one.keyframes.values()] == [
        encode(kf) for kf in other.keyframes.values()
    ]


@pytest.mark.parametrize("name", TRACKS)
def test_tracks_are_what_they_say(name: str) -> None:
    fleet, query, cand = generate(TRACKS[name], 1)
    assert list(fleet.keyframes)[-1] == query
    robots = {kf.agent for kf in fleet.keyframes}
    assert robots == {query.agent, cand.agent} and query.agent != cand.agent
    for robot, count in ((cand.agent, KEYFRAMES), (query.agent, KEYFRAMES // 2 + 1)):
        mine = [kf for kf in fleet.keyframes.values() if kf.id.agent == robot]
        assert [kf.id.seq for kf in mine] == list(range(count))
        true = np.stack([fleet.T_world_body[kf.id] for kf in mine])
        steps = inverse(true[:-1]) @ true[1:]
        metres = np.linalg.norm(steps[:, :3, 3], axis=1)
        assert ((metres > 0.119) & (metres < 0.201)).all()
        # Odometry is wrong, but not by much.
        odometry = np.stack([kf.T_odom_body for kf in mine])
        errors = inverse(steps) @ inverse(odometry[:-1]) @ odometry[1:]
        assert 0 < np.linalg.norm(errors[:, :3, 3], axis=1).max() < 0.1
        assert 0 < rotation_angle(errors).max() < 0.1
    T_cand_query = inverse(fleet.T_world_body[cand]) @ fleet.T_world_body[query]
    assert 0.1 <= np.linalg.norm(T_cand_query[:3, 3]) <= 1.0


def test_both_rules_close_the_loop_with_rigs_of_their_own() -> None:
    fleet, query, cand = generate(TRACKS["forward_room"], 2)
    found = {}
    for rule in ("index", "geometry"):
        tally = Tally()
        solve(with_rigs(fleet, rule, (2, 3)), {frozenset((query, cand))}, tally)
        found[rule] = figures(tally, LIMITS)
        assert (found[rule]["jobs"], found[rule]["accepted"], found[rule]["wrong"]) == (1, 1, 0)
    assert found["geometry"]["sigma_m"] < found["index"]["sigma_m"]
