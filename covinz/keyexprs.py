"""Every Zenoh key expression of covinz, built and parsed here only.

Agents touch only ``covinz/agent/{own id}/**``, so that access control is one rule an agent.
"""

from __future__ import annotations

from covinz.types import AGENT_PATTERN, KeyframeId

AGENT_KEYFRAMES = "covinz/agent/*/up/keyframe"
AGENT_CAMERAS = "covinz/agent/*/up/camera"
AGENT_STATUSES = "covinz/agent/*/up/status"
AGENT_CORRECTIONS = "covinz/agent/*/down/correction"
AGENTS_ALIVE = "covinz/agent/*/alive"
# What the server answers of robots, as its processes declare it and in general.
AGENTS_ANSWERED = ("covinz/agent/*/up/*", "covinz/agent/*/down/*")
LOG_HEAD = "covinz/log/head"
LOG_RANGE = "covinz/log/range"
KEYFRAMES = "covinz/keyframe/*/*/*"
CAMERAS = "covinz/camera/*"
JOB_LEASE = "covinz/job/lease"
JOB_DONE = "covinz/job/done"
JOB_LIST = "covinz/job/list"
JOB_LOOPS = "covinz/job/loops"
JOB_RETRIES = "covinz/job/retry/*"
WORKERS_ALIVE = "covinz/job/worker/*/alive"
LOOP = "covinz/loop"
REJECTION = "covinz/rejection"
MAP_LIST = "covinz/map/list"
MAP_SNAPSHOTS = "covinz/map/snapshot/*"
SERVICES_ALIVE = "covinz/service/*/*/alive"
SERVICES_STATUS = "covinz/service/*/*/status"


def agent_up(agent: str) -> str:
    """Everything that an agent sends."""
    return f"covinz/agent/{agent}/up/**"


def agent_down(agent: str) -> str:
    """Everything that is sent to an agent."""
    return f"covinz/agent/{agent}/down/**"


def agent_keyframe(agent: str) -> str:
    """Upload of keyframes and gaps: query + ack, agent -> ingest, never lost."""
    return f"covinz/agent/{agent}/up/keyframe"


def agent_camera(agent: str) -> str:
    """Registration of a calibration: query + ack, agent -> ingest."""
    return f"covinz/agent/{agent}/up/camera"


def agent_status(agent: str) -> str:
    """What ingest has seen of an agent since it was started: query; agent or operator -> ingest."""
    return f"covinz/agent/{agent}/up/status"


def agent_correction(agent: str) -> str:
    """Latest correction of an agent: put, and answers get; optimizer -> agent."""
    return f"covinz/agent/{agent}/down/correction"


def agent_alive(agent: str) -> str:
    """Liveliness token of an agent."""
    return f"covinz/agent/{agent}/alive"


def agent_of(key: str) -> str:
    """The agent id in a ``covinz/agent/{agent}/...`` key.

    Raises:
        ValueError: If the key is of another kind or the id malformed.
    """
    parts = key.split("/")
    if parts[:2] != ["covinz", "agent"] or len(parts) < 4 or not AGENT_PATTERN.fullmatch(parts[2]):
        raise ValueError(f"no agent in key {key!r}")
    return parts[2]


def keyframe(keyframe_id: KeyframeId) -> str:
    """One keyframe, features included: query -> ingest."""
    return f"covinz/keyframe/{keyframe_id}"


def keyframe_of(key: str) -> KeyframeId:
    """The id in a ``covinz/keyframe/{agent}/{session}/{seq}`` key; ValueError otherwise."""
    prefix = "covinz/keyframe/"
    if not key.startswith(prefix):
        raise ValueError(f"no keyframe in key {key!r}")
    return KeyframeId.parse(key.removeprefix(prefix))


def camera(camera_hash: str) -> str:
    """One registered calibration: query -> ingest."""
    return f"covinz/camera/{camera_hash}"


def camera_of(key: str) -> str:
    """The calibration hash in a ``covinz/camera/{hash}`` key; ValueError otherwise."""
    parts = key.split("/")
    if parts[:2] != ["covinz", "camera"] or len(parts) != 3:
        raise ValueError(f"no camera in key {key!r}")
    return parts[2]


def worker_alive(worker: str) -> str:
    """Liveliness token of one run of a worker: while it is there its lease may last."""
    return f"covinz/job/worker/{worker}/alive"


def worker_of(key: str) -> str:
    """The worker in a ``covinz/job/worker/{worker}/alive`` key; ValueError otherwise."""
    parts = key.split("/")
    if parts[:3] != ["covinz", "job", "worker"] or len(parts) != 5:
        raise ValueError(f"no worker in key {key!r}")
    return parts[3]


def job_retry(job_id: str) -> str:
    """Do a job that was given up after all: query -> dispatcher, answered by an UploadReply."""
    return f"covinz/job/retry/{job_id}"


def job_of(key: str) -> str:
    """The job in a ``covinz/job/retry/{job}`` key; ValueError otherwise."""
    parts = key.split("/")
    if parts[:3] != ["covinz", "job", "retry"] or len(parts) != 4:
        raise ValueError(f"no job in key {key!r}")
    return parts[3]


def map_snapshot(map_id: str) -> str:
    """One map with its graph: query -> optimizer."""
    return f"covinz/map/snapshot/{map_id}"


def map_of(key: str) -> str:
    """The map id in a ``covinz/map/snapshot/{map_id}`` key; ValueError otherwise."""
    parts = key.split("/")
    if parts[:3] != ["covinz", "map", "snapshot"] or len(parts) != 4:
        raise ValueError(f"no map in key {key!r}")
    return parts[3]


def service_alive(service: str, instance: str) -> str:
    """Liveliness token of a process."""
    return f"covinz/service/{service}/{instance}/alive"


def service_status(service: str, instance: str) -> str:
    """Status of a process: query."""
    return f"covinz/service/{service}/{instance}/status"


def service_of(key: str) -> tuple[str, str]:
    """(service, instance) of a ``covinz/service/...`` key; ValueError otherwise."""
    parts = key.split("/")
    if parts[:2] != ["covinz", "service"] or len(parts) != 5:
        raise ValueError(f"no service in key {key!r}")
    return parts[2], parts[3]
