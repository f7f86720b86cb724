"""How the check of docker-compose.yml gets in: in the clear, or with credentials of a roster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from covinz.access.credentials import with_credentials, write_secret
from covinz.config import BusConfig
from scripts.compose_project import ComposeProject

OPERATOR = "check-operator"


@dataclass(frozen=True, slots=True)
class Access:
    """What programs outside of the containers are given.

    Attributes:
        port: Of the router, on this machine.
        credentials: Folder of ``NAME.covinz`` files; None: everybody may connect, in the clear.
    """

    port: int
    credentials: Path | None = None

    @property
    def endpoint(self) -> str:
        """Of the router, in the clear."""
        return f"tcp/127.0.0.1:{self.port}"

    def bus(self) -> BusConfig:
        """For a session of an operator."""
        if self.credentials is None:
            return BusConfig(endpoint=self.endpoint)
        return with_credentials(BusConfig(), self._of_operator)

    @property
    def of_commands(self) -> list[str]:
        """Options of `covinz` commands."""
        if self.credentials is None:
            return ["--endpoint", self.endpoint]
        return ["--credentials", str(self._of_operator)]

    @property
    def of_robots(self) -> list[str]:
        """Options of the player."""
        if self.credentials is None:
            return ["--endpoint", self.endpoint]
        return ["--credentials", str(self.credentials)]

    @property
    def _of_operator(self) -> Path:
        assert self.credentials is not None
        return self.credentials / f"{OPERATOR}.covinz"


def let_in(project: ComposeProject, port: int, robots: Sequence[str], folder: Path) -> Access:
    """Make a roster in the project's volume, and credentials for robots and an operator."""
    folder.mkdir()
    where = ("--server", "127.0.0.1", "--port", str(port))
    for name in (*robots, OPERATOR):
        options = (*where, "--operator") if name == OPERATOR else where
        write_secret(folder / f"{name}.covinz", project.roster_add(name, *options))
    return Access(port, folder)
