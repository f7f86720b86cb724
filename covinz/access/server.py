"""Where a server listens and who it is to its own router, when there is a roster and when not."""

from __future__ import annotations

from pathlib import Path

from covinz.access.roster import Roster, RosterError, bracketed
from covinz.config import BusConfig

_LOOPBACK = "127.0.0.1"
_EVERYWHERE = ("0.0.0.0", "::")


def server_bus(bus: BusConfig, folder: Path, listen: str | None) -> BusConfig:
    """The bus of a server's processes.

    Without a roster as it is configured. With one everybody needs credentials, also the server's
    own processes, which use those in its folder.

    Args:
        bus: As configured.
        folder: Of the roster, which need not exist.
        listen: Address of this machine where robots connect; None: this machine only.

    Raises:
        RosterError: If robots are to be let in but nobody was ever added, or it cannot be read.
    """
    roster = Roster(folder if bus.roster is None else bus.roster)
    if not roster.exists():
        if listen is None and bus.roster is None:
            return bus
        raise RosterError(
            "nobody could connect: there is no roster yet. Let a robot in first: "
            f"`covinz roster add NAME --server HOST --data {folder.parent}`"
        )
    port = roster.read().port
    # Everywhere includes here; the server's own processes connect here.
    addresses = dict.fromkeys([_LOOPBACK, listen or _LOOPBACK])
    if listen in _EVERYWHERE:
        addresses = {listen: None}
    ours = {
        "endpoint": f"tls/{_LOOPBACK}:{port}",
        "listen": tuple(
            f"{protocol}/{bracketed(address)}:{port}"
            for address in addresses
            for protocol in ("tls", "quic")
        ),
    }
    if bus.listen and listen is None:  # told exactly
        ours = {}
    return bus.model_copy(
        update={
            **ours,
            "roster": roster.folder.resolve(),
            "credentials": roster.server_credentials.resolve(),
        }
    )
