"""Keys are parsed into what they were built from, and match the patterns that are subscribed."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from hypothesis import given

from covinz import keyexprs
from covinz.types import KeyframeId
from tests.contract.examples import OLD
from tests.unit.covinz.messages import agents, hashes, keyframe_ids, names, ulids

OF_AGENT = [
    keyexprs.agent_keyframe,
    keyexprs.agent_camera,
    keyexprs.agent_correction,
    keyexprs.agent_alive,
]


def matches(pattern: str, key: str) -> bool:
    """Whether Zenoh would deliver `key` to `pattern`, where * stands for one part."""
    return re.fullmatch(pattern.replace("*", "[^/]+"), key) is not None


@given(agents)
def test_agent_keys(agent: str) -> None:
    for build in OF_AGENT:
        assert keyexprs.agent_of(build(agent)) == agent
        assert build(agent).startswith(f"covinz/agent/{agent}/")
    assert matches(keyexprs.AGENT_KEYFRAMES, keyexprs.agent_keyframe(agent))
    assert matches(keyexprs.AGENT_CAMERAS, keyexprs.agent_camera(agent))
    assert matches(keyexprs.AGENT_CORRECTIONS, keyexprs.agent_correction(agent))
    assert matches(keyexprs.AGENTS_ALIVE, keyexprs.agent_alive(agent))


@given(keyframe_ids)
def test_keyframe_key(keyframe_id: KeyframeId) -> None:
    key = keyexprs.keyframe(keyframe_id)
    assert keyexprs.keyframe_of(key) == keyframe_id
    assert matches(keyexprs.KEYFRAMES, key)


@given(hashes)
def test_camera_key(camera_hash: str) -> None:
    key = keyexprs.camera(camera_hash)
    assert keyexprs.camera_of(key) == camera_hash
    assert matches(keyexprs.CAMERAS, key)


@given(ulids)
def test_map_key(map_id: str) -> None:
    key = keyexprs.map_snapshot(map_id)
    assert keyexprs.map_of(key) == map_id
    assert matches(keyexprs.MAP_SNAPSHOTS, key)


@given(names)
def test_worker_key(worker: str) -> None:
    key = keyexprs.worker_alive(worker)
    assert keyexprs.worker_of(key) == worker
    assert matches(keyexprs.WORKERS_ALIVE, key)


@given(names, names)
def test_service_keys(service: str, instance: str) -> None:
    alive = keyexprs.service_alive(service, instance)
    status = keyexprs.service_status(service, instance)
    assert keyexprs.service_of(alive) == keyexprs.service_of(status) == (service, instance)
    assert matches(keyexprs.SERVICES_ALIVE, alive)
    assert matches(keyexprs.SERVICES_STATUS, status)


@pytest.mark.parametrize(
    ("parse", "key"),
    [
        (keyexprs.agent_of, ""),
        (keyexprs.agent_of, "covinz/agent/robot"),
        (keyexprs.agent_of, "covinz/agent/Robot/alive"),
        (keyexprs.agent_of, "covinz/agent/*/alive"),
        (keyexprs.agent_of, "covinz/agent//alive"),
        (keyexprs.agent_of, "other/agent/robot/alive"),
        (keyexprs.keyframe_of, "covinz/keyframe/robot"),
        (keyexprs.keyframe_of, f"covinz/keyframes/robot/{OLD}/0"),
        (keyexprs.keyframe_of, f"covinz/keyframe/robot/{OLD}/-1"),
        (keyexprs.keyframe_of, "covinz/keyframe/*/*/*"),
        (keyexprs.camera_of, "covinz/camera"),
        (keyexprs.camera_of, "covinz/camera/a/b"),
        (keyexprs.camera_of, "covinz/keyframe/a"),
        (keyexprs.map_of, "covinz/map/list"),
        (keyexprs.map_of, "covinz/map/snapshot/a/b"),
        (keyexprs.worker_of, "covinz/job/worker/a"),
        (keyexprs.worker_of, "covinz/job/lease/a/alive"),
        (keyexprs.service_of, "covinz/service/ingest"),
        (keyexprs.service_of, "covinz/agent/ingest/main/alive"),
    ],
)
def test_other_keys_are_refused(parse: Callable[[str], object], key: str) -> None:
    with pytest.raises(ValueError, match="key"):
        parse(key)
