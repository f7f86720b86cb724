"""How far a process is: Status."""

from __future__ import annotations

from covinz.codec import values
from covinz.codec.reader import Fields
from covinz.types import Status


def status_fields(status: Status) -> Fields:
    """Fields of a Status."""
    return {
        "service": values.text(status.service, "service", values.INSTANCE),
        "instance": values.text(status.instance, "instance", values.INSTANCE),
        "log_id": values.ulid(status.log_id, "log_id") if status.log_id else None,
        "cursor": values.whole(status.cursor, "cursor"),
        "pending": values.whole(status.pending, "pending"),
        "leased": values.whole(status.leased, "leased"),
        "dirty": bool(status.dirty),
        "counters": [
            {"name": values.text(name, "name"), "value": values.finite(value, name)}
            for name, value in sorted(status.counters.items())
        ],
        "version": values.text(status.version, "version", values.VERSION)
        if status.version
        else None,
        "now_ns": None if status.now_ns is None else values.whole(status.now_ns, "now_ns"),
    }


def status(fields: Fields) -> Status:
    """The inverse of `status_fields`."""
    names = [counter["name"] for counter in fields["counters"]]
    if names != sorted(set(names)):
        raise ValueError("counters: names are not in strictly increasing order")
    log_id = fields["log_id"]
    return Status(
        service=values.text(fields["service"], "service", values.INSTANCE),
        instance=values.text(fields["instance"], "instance", values.INSTANCE),
        log_id="" if log_id is None else values.ulid(log_id, "log_id"),
        cursor=values.whole(fields["cursor"], "cursor"),
        pending=values.whole(fields["pending"], "pending"),
        leased=values.whole(fields["leased"], "leased"),
        dirty=fields["dirty"],
        counters={
            counter["name"]: values.finite(counter["value"], counter["name"])
            for counter in fields["counters"]
        },
        version=values.text(fields["version"], "version", values.VERSION)
        if fields["version"]
        else "",
        now_ns=None if fields["now_ns"] is None else values.whole(fields["now_ns"], "now_ns"),
    )
