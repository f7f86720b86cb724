from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.bus import BusClosed, Query
from covinz.keyframes import (
    CameraNotFound,
    KeyframeNotFound,
    RemoteKeyframeStore,
    StoreUnavailable,
)
from covinz.memory_bus import Hub, InMemoryBus
from covinz.types import Camera, Features, FeatureType, Keyframe, KeyframeId

SESSION = "01J9Z0000000000000000000CC"
CAMERA = Camera("PINHOLE", 640, 480, np.array([500.0, 500.0, 319.5, 239.5]), np.eye(4))


def keyframe(seq: int) -> Keyframe:
    features = Features(
        FeatureType.ORB,
        np.array([[10.0, 20.0], [30.5, 40.25]], "f4"),
        np.arange(64, dtype="u1").reshape(2, 32),
    )
    return Keyframe(KeyframeId("a", SESSION, seq), 1000 + seq, np.eye(4), CAMERA.hash, features)


class Server:
    """Answers for ten keyframes and one camera as ingest does; counts the questions."""

    def __init__(self, bus: InMemoryBus) -> None:
        self.bus = bus
        self.asked: Counter[str] = Counter()
        self.answers = {keyexprs.keyframe(keyframe(i).id): keyframe(i) for i in range(10)}
        self.declared = [bus.answer(key, self._answer) for key in (keyexprs.KEYFRAMES,)]
        self.declared.append(bus.answer(keyexprs.CAMERAS, self._answer))

    def _answer(self, query: Query) -> None:
        self.asked[query.key] += 1
        if query.key == keyexprs.camera(CAMERA.hash):
            query.reply(codec.encode(CAMERA))
        elif query.key in self.answers:
            query.reply(codec.encode(self.answers[query.key]))
        else:
            query.reply(b"")


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def server(hub: Hub) -> Iterator[Server]:
    with closing(hub.join()) as bus:
        yield Server(bus)


@pytest.fixture
def client(hub: Hub) -> Iterator[InMemoryBus]:
    with closing(hub.join()) as bus:
        yield bus


def test_a_keyframe_comes_with_its_features_and_is_asked_for_once(
    server: Server, client: InMemoryBus
) -> None:
    store = RemoteKeyframeStore(client, 10)
    found = store.keyframe(keyframe(3).id)
    assert found.id == keyframe(3).id and found.features is not None
    np.testing.assert_array_equal(found.features.descriptors, np.arange(64).reshape(2, 32))
    assert store.keyframe(keyframe(3).id) is found
    assert server.asked[keyexprs.keyframe(found.id)] == 1


def test_a_camera_is_asked_for_once(server: Server, client: InMemoryBus) -> None:
    store = RemoteKeyframeStore(client, 10)
    assert store.camera(CAMERA.hash).hash == CAMERA.hash
    assert store.camera(CAMERA.hash) is store.camera(CAMERA.hash)
    assert server.asked[keyexprs.camera(CAMERA.hash)] == 1


def test_what_was_used_least_recently_is_forgotten_first(
    server: Server, client: InMemoryBus
) -> None:
    store = RemoteKeyframeStore(client, 2)
    for seq in (0, 1, 0, 2, 0, 1):
        store.keyframe(keyframe(seq).id)
    asked = [server.asked[keyexprs.keyframe(keyframe(seq).id)] for seq in range(3)]
    assert asked == [1, 2, 1]


@pytest.mark.usefixtures("server")
def test_what_is_not_there_is_not_found(client: InMemoryBus) -> None:
    store = RemoteKeyframeStore(client, 2)
    with pytest.raises(KeyframeNotFound, match=f"a/{SESSION}/99"):
        store.keyframe(keyframe(99).id)
    with pytest.raises(CameraNotFound, match="0123456789abcdef"):
        store.camera("0123456789abcdef")


def test_not_found_is_not_remembered(server: Server, client: InMemoryBus) -> None:
    store = RemoteKeyframeStore(client, 2)
    late = keyframe(99)
    with pytest.raises(KeyframeNotFound):
        store.keyframe(late.id)
    server.answers[keyexprs.keyframe(late.id)] = late
    assert store.keyframe(late.id).id == late.id


def test_a_silent_store_is_unavailable_but_memory_stays(
    server: Server, client: InMemoryBus
) -> None:
    store = RemoteKeyframeStore(client, 2)
    store.keyframe(keyframe(0).id)
    for declared in server.declared:
        declared.close()
    assert store.keyframe(keyframe(0).id).id == keyframe(0).id
    with pytest.raises(StoreUnavailable, match="nobody"):
        store.keyframe(keyframe(1).id)
    with pytest.raises(StoreUnavailable, match="nobody"):
        store.camera(CAMERA.hash)


def test_an_answer_that_cannot_be_right_makes_the_store_unavailable(
    server: Server, client: InMemoryBus
) -> None:
    store = RemoteKeyframeStore(client, 2)
    server.answers[keyexprs.keyframe(keyframe(0).id)] = keyframe(1)
    with pytest.raises(StoreUnavailable, match="got"):
        store.keyframe(keyframe(0).id)
    for declared in server.declared:
        declared.close()
    server.bus.answer("covinz/**", lambda query: query.reply(b"nonsense"))
    with pytest.raises(StoreUnavailable, match="unreadable"):
        store.keyframe(keyframe(0).id)
    with pytest.raises(StoreUnavailable, match="unreadable"):
        store.camera(CAMERA.hash)


def test_another_camera_than_asked_for_is_refused(client: InMemoryBus, hub: Hub) -> None:
    with closing(hub.join()) as bus:
        bus.answer(keyexprs.CAMERAS, lambda query: query.reply(codec.encode(CAMERA)))
        with pytest.raises(StoreUnavailable, match=CAMERA.hash):
            RemoteKeyframeStore(client, 2).camera("0123456789abcdef")


def test_the_end_of_the_bus_is_passed_on(server: Server, client: InMemoryBus) -> None:
    store = RemoteKeyframeStore(client, 2)
    client.interrupt()
    with pytest.raises(BusClosed):
        store.keyframe(keyframe(0).id)
    assert not server.asked


def test_a_memory_for_nothing_is_refused(client: InMemoryBus) -> None:
    with pytest.raises(ValueError, match="capacity"):
        RemoteKeyframeStore(client, 0)
