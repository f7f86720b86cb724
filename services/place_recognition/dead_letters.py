"""Saves the input of jobs that were given up, so that what went wrong can be seen again."""

from __future__ import annotations

import logging
from collections import deque
from pathlib import Path

from covinz.bus import BusClosed
from covinz.config import LoopSolverConfig
from covinz.keyframes import CameraNotFound, KeyframeNotFound, KeyframeStore, StoreUnavailable
from covinz.machine import THIS_MACHINE, Machine
from covinz.saved_job import gather, saved_job_path, write_saved_job
from covinz.types import LoopJob

logger = logging.getLogger(__name__)

# Jobs that wait to be saved; of more the newest are saved when the process starts again.
MAX_WAITING = 64
# Between two questions to a store that does not answer. [s]
PAUSE_S = 2.0


class DeadLetters:
    """Fetches and writes in a thread of its own: the jobs' owner never waits for it.

    Args:
        store: Where the keyframes come from.
        config: The solver's, part of the input.
        data: The server's data folder.
        machine: For the thread.
    """

    def __init__(
        self,
        store: KeyframeStore,
        config: LoopSolverConfig,
        data: Path,
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._store = store
        self._config = config
        self._data = data
        self._changed = machine.condition()  # guards what follows
        self._waiting: deque[LoopJob] = deque()
        self._closing = False
        self._thread = machine.thread(self._run, "dead-letters", daemon=True)
        self._thread.start()

    def save(self, job: LoopJob) -> None:
        """Save a job some time soon."""
        with self._changed:
            if len(self._waiting) < MAX_WAITING:
                self._waiting.append(job)
                self._changed.notify_all()

    def close(self) -> None:
        """Save nothing more."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._waiting)
                if self._closing:
                    return
                job = self._waiting[0]
            try:
                is_over = self._try(job)
            except BusClosed:
                return
            with self._changed:
                if is_over:
                    self._waiting.popleft()
                else:
                    self._changed.wait_for(lambda: self._closing, PAUSE_S)

    def _try(self, job: LoopJob) -> bool:
        """Save a job; False when it has to be tried again."""
        path = saved_job_path(self._data, job.id)
        if path.exists():
            return True
        try:
            write_saved_job(path, gather(job, self._config, self._store))
        except StoreUnavailable:
            return False
        except (KeyframeNotFound, CameraNotFound, OSError) as error:
            logger.error("the input of job %s is not saved: %s", job.id, error)
        else:
            logger.error("the input of job %s is saved in %s", job.id, path)
        return True
