"""A robot that sends every keyframe twice and out of order, by the public key for uploads.

What its own code would never do, but what the network may make of it. It says what happens like
`benchmarks.drill.robot`, whose arguments it takes.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing

from benchmarks.drill.recording import read
from benchmarks.drill.robot import Voice, parser
from covinz import codec, keyexprs
from covinz.bus import Bus, ZenohBus
from covinz.config import BusConfig
from covinz.types import Duplicate, Keyframe, KeyframeId, Stored, UploadReply

# So many keyframes are put out of order among themselves.
_WINDOW = 6
_SEED = 5
_RETRY_S = 0.1


def main() -> None:
    """Play one robot."""
    arguments = parser().parse_args()
    voice = Voice()
    recording = read(arguments.keyframes, arguments.agent)
    pause = threading.Event()
    with closing(ZenohBus.open(BusConfig(endpoint=arguments.way))) as bus:
        voice.say(open=0)
        camera = codec.encode(recording.contents[0].camera)
        upload(bus, keyexprs.agent_camera(arguments.agent), camera)
        acked = set()
        for number in order(len(recording.contents)):
            content = recording.contents[number]
            name = KeyframeId(arguments.agent, recording.session, number)
            keyframe = Keyframe(
                name,
                content.stamp_ns,
                content.T_odom_body,
                content.camera.hash,
                content.features,
                content.covariance,
                content.gravity_body,
                more_features=content.more_features,
            )
            if number not in acked:
                voice.say(sent=str(name), number=number, block_ms=0.0)
            upload(bus, keyexprs.agent_keyframe(arguments.agent), codec.encode(keyframe))
            acked.add(number)
            voice.say(acked=len(acked))
            pause.wait(0.5 / arguments.rate if arguments.rate else 0.0)
        voice.say(done=len(acked))


def order(count: int) -> Iterator[int]:
    """Every number twice, at random among those near to it."""
    draw = random.Random(_SEED)
    for begin in range(0, count, _WINDOW):
        numbers = 2 * list(range(begin, min(begin + _WINDOW, count)))
        draw.shuffle(numbers)
        yield from numbers
    # And the first ones once more, long after.
    yield from range(min(_WINDOW, count))


def upload(bus: Bus, key: str, payload: bytes) -> None:
    """Send until it is stored; raises ValueError when it is refused."""
    while True:
        replies: Sequence[bytes] = bus.ask(key, payload)
        if replies:
            answer: UploadReply = codec.decode_upload_reply(replies[0])
            if isinstance(answer, Stored | Duplicate):
                return
            raise ValueError(f"not stored: {answer}")
        time.sleep(_RETRY_S)


if __name__ == "__main__":
    main()
