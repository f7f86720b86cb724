"""The real ingest service in a thread of the test, on an in-memory bus."""

from __future__ import annotations

import threading
from pathlib import Path
from types import TracebackType

from covinz import codec, keyexprs
from covinz.bus import Bus
from covinz.config import Config, IngestConfig
from covinz.memory_bus import Hub
from covinz.service import Inbox, serve_on
from covinz.types import LogEntry, LogPage, LogRange, LogView, Status
from services.ingest.service import run

WAIT_S = 20.0


class LocalIngest:
    """Ingest with its log in `folder`, ready when the block begins; stopped at its end."""

    def __init__(self, hub: Hub, folder: Path, config: IngestConfig | None = None) -> None:
        self.bus = hub.join()
        self.asker = hub.join()
        self._folder = folder
        self._config = Config(ingest=config or IngestConfig())
        self._inbox: Inbox | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="ingest")

    def __enter__(self) -> LocalIngest:
        watch = self.asker.watch_alive(
            keyexprs.service_alive("ingest", "ingest"), lambda _, alive: self._ready.set()
        )
        self._thread.start()
        assert self._ready.wait(WAIT_S)
        watch.close()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        assert self._inbox is not None
        self._inbox.stop()
        self._thread.join()
        self.bus.close()
        self.asker.close()

    def status(self) -> Status:
        """How far it is."""
        (reply,) = self.asker.ask(keyexprs.service_status("ingest", "ingest"))
        return codec.decode(reply, Status)

    def entries(self, view: LogView = LogView.POSE) -> list[LogEntry]:
        """The whole log."""
        entries: list[LogEntry] = []
        while True:
            question = codec.encode(LogRange(len(entries), view))
            (reply,) = self.asker.ask(keyexprs.LOG_RANGE, question)
            page = codec.decode(reply, LogPage)
            entries += page.entries
            if len(entries) == page.head:
                return entries

    def _serve(self) -> None:
        serve_on(self.bus, "ingest", "ingest", self._config, self._folder, run, self._arm)

    def _arm(self, inbox: Inbox, _: Bus) -> None:
        self._inbox = inbox
