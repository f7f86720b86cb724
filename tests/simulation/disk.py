"""Disks that lose what was not synced: a layer below SQLite that knows every write and every sync.

SQLite lets a program put its own file system layer (VFS) in place. Ours passes everything on to
the usual one, but notes what is written and what has been synced, file by file. So a crash can
leave what a killed process leaves (all that was written) or what a power cut leaves: the synced
state, and of what was written since any part in any order, the last write torn.

Source: https://www.sqlite.org/vfs.html; https://www.sqlite.org/testing.html, "crash testing".
"""

from __future__ import annotations

import _sqlite3
import ctypes
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

OK, IOERR, FULL = 0, 10, 13
SECTOR = 512
_VOID, _INT, _I64 = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64
_Write = ctypes.CFUNCTYPE(_INT, _VOID, _VOID, _INT, _I64)
_Truncate = ctypes.CFUNCTYPE(_INT, _VOID, _I64)
_Sync = ctypes.CFUNCTYPE(_INT, _VOID, _INT)
_Close = ctypes.CFUNCTYPE(_INT, _VOID)
_Open = ctypes.CFUNCTYPE(_INT, _VOID, _VOID, _VOID, _INT, _VOID)
_Delete = ctypes.CFUNCTYPE(_INT, _VOID, _VOID, _INT)
_POINTERS = "xClose xRead xWrite xTruncate xSync xFileSize xLock xUnlock xCheckReservedLock"
_POINTERS += " xFileControl xSectorSize xDeviceCharacteristics xShmMap xShmLock xShmBarrier"
_POINTERS += " xShmUnmap xFetch xUnfetch"
_CALLS = "xOpen xDelete xAccess xFullPathname xDlOpen xDlError xDlSym xDlClose xRandomness xSleep"
_CALLS += " xCurrentTime xGetLastError xCurrentTimeInt64 xSetSystemCall xGetSystemCall"
_CALLS += " xNextSystemCall"


class _IoMethods(ctypes.Structure):
    """sqlite3_io_methods, version 3."""

    _fields_ = [("iVersion", _INT), *[(name, _VOID) for name in _POINTERS.split()]]


class _Vfs(ctypes.Structure):
    """sqlite3_vfs, version 3."""

    _fields_ = [
        ("iVersion", _INT),
        ("szOsFile", _INT),
        ("mxPathname", _INT),
        ("pNext", _VOID),
        ("zName", ctypes.c_char_p),
        ("pAppData", _VOID),
        *[(name, _VOID) for name in _CALLS.split()],
    ]


@dataclass(slots=True)
class _File:
    """A file: what is safe, and what was written (or cut off: None) since."""

    synced: bytearray = field(default_factory=bytearray)
    since: list[tuple[int, bytes | None]] = field(default_factory=list)

    def sync(self) -> None:
        self.synced = _applied(self.synced, self.since)
        self.since = []


class Disk:
    """The disk of one process in one run of it, as a folder.

    Attributes:
        is_full: Nothing more can be written.
        is_lying: It says that it has synced and has not.
        is_gone: The process is dead: nothing is written any more.
        writes_left: After so many writes `on_fuse` is called, if not None.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.is_full = False
        self.is_lying = False
        self.is_gone = False
        self.writes_left: int | None = None
        self.on_fuse: Callable[[], object] = lambda: None
        self._files: dict[str, _File] = {}

    def load(self, image: dict[str, bytes]) -> None:
        """Begin with what an earlier run has left."""
        self.folder.mkdir(parents=True)
        for name, content in image.items():
            (self.folder / name).write_bytes(content)
            self._files[name] = _File(bytearray(content))

    def left_by_kill(self) -> dict[str, bytes]:
        """What is there after the process was killed: all that it has written."""
        return {name: bytes(_applied(f.synced, f.since)) for name, f in self._files.items()}

    def left_by_power_cut(self, draw: random.Random) -> dict[str, bytes]:
        """What is there after a power cut: of what was not synced anything or nothing."""
        image = {}
        share = draw.choice([0.0, 0.5, 0.9, 1.0])
        for name, one in sorted(self._files.items()):
            kept = [change for change in one.since if draw.random() < share]
            if kept and kept[-1][1] is not None and draw.random() < 0.5:
                offset, data = kept[-1]
                assert data is not None
                kept[-1] = offset, data[: SECTOR * draw.randint(0, len(data) // SECTOR)]
            image[name] = bytes(_applied(one.synced, kept))
        return image

    def wrote(self, name: str, offset: int, data: bytes | None) -> int:
        """A write, or a cut when `data` is None; returns SQLite's result code."""
        if self.is_gone:
            return IOERR
        if self.is_full and data is not None:
            return FULL
        self._files.setdefault(name, _File()).since.append((offset, data))
        if self.writes_left is not None:
            self.writes_left -= 1
            if self.writes_left < 0:
                self.writes_left = None
                self.on_fuse()
                return IOERR
        return OK

    def synced(self, name: str) -> None:
        """A file is safe up to here."""
        if not (self.is_lying or self.is_gone) and name in self._files:
            self._files[name].sync()

    def deleted(self, name: str) -> None:
        """A file is gone."""
        if not self.is_gone:
            self._files.pop(name, None)


class Layer:
    """The file system layer; `disks` are those it looks after."""

    def __init__(self) -> None:
        self.disks: dict[str, Disk] = {}
        self._open: dict[int, tuple[Disk, str]] = {}
        self._methods: dict[int, _IoMethods] = {}
        self._keep: list[object] = []  # callbacks live as long as the layer
        self._lib = ctypes.PyDLL(_sqlite3.__file__)
        find, register = self._lib.sqlite3_vfs_find, self._lib.sqlite3_vfs_register
        find.argtypes, find.restype = [ctypes.c_char_p], _VOID
        register.argtypes, register.restype = [_VOID, _INT], _INT
        self._lib.sqlite3_vfs_unregister.argtypes = [_VOID]
        self._usual = find(None)
        usual = _Vfs.from_address(self._usual)
        self._vfs = _Vfs()
        ctypes.memmove(ctypes.byref(self._vfs), self._usual, ctypes.sizeof(_Vfs))
        self._vfs.zName = b"covinz-simulation"
        self._usual_open, self._usual_delete = _Open(usual.xOpen), _Delete(usual.xDelete)
        self._vfs.xOpen = self._address(_Open(self._on_open))
        self._vfs.xDelete = self._address(_Delete(self._on_delete))

    @contextmanager
    def installed(self) -> Iterator[Layer]:
        """SQLite uses the layer inside of the block, for files that are opened there."""
        self._lib.sqlite3_vfs_register(ctypes.addressof(self._vfs), 1)
        try:
            yield self
        finally:
            self._lib.sqlite3_vfs_unregister(ctypes.addressof(self._vfs))
            self._lib.sqlite3_vfs_register(self._usual, 1)

    def _address(self, callback: ctypes._CFunctionType) -> int | None:
        self._keep.append(callback)
        return ctypes.cast(callback, _VOID).value

    def _at(self, address: int | None) -> tuple[Disk, str] | None:
        if not address:
            return None
        path = Path(ctypes.string_at(address).decode())
        disk = self.disks.get(str(path.parent))
        return None if disk is None else (disk, path.name)

    def _on_open(
        self, vfs: int, name: int | None, file: int, flags: int, out_flags: int | None
    ) -> int:
        code = self._usual_open(vfs, name, file, flags, out_flags)
        place = self._at(name)
        if code == OK and place is not None:
            methods = _VOID.from_address(file)
            assert methods.value is not None
            self._open[file] = place
            methods.value = ctypes.addressof(self._watched(methods.value))
        return int(code)

    def _on_delete(self, vfs: int, name: int, sync_folder: int) -> int:
        place = self._at(name)
        if place is not None:
            place[0].deleted(place[1])
        return int(self._usual_delete(vfs, name, sync_folder))

    def _watched(self, usual: int) -> _IoMethods:
        """The methods of a file, with ours in the place of some."""
        if usual in self._methods:
            return self._methods[usual]
        theirs, ours = _IoMethods.from_address(usual), _IoMethods()
        ctypes.memmove(ctypes.byref(ours), usual, ctypes.sizeof(_IoMethods))
        write, cut = _Write(theirs.xWrite), _Truncate(theirs.xTruncate)
        close = _Close(theirs.xClose)

        def on_write(file: int, data: int, count: int, offset: int) -> int:
            disk, name = self._open[file]
            code = disk.wrote(name, offset, ctypes.string_at(data, count))
            return code or int(write(file, data, count, offset))

        def on_truncate(file: int, size: int) -> int:
            disk, name = self._open[file]
            return disk.wrote(name, size, None) or int(cut(file, size))

        def on_sync(file: int, _: int) -> int:
            disk, name = self._open[file]
            disk.synced(name)
            return IOERR if disk.is_gone else OK

        def on_close(file: int) -> int:
            del self._open[file]
            return int(close(file))

        ours.xWrite = self._address(_Write(on_write))
        ours.xTruncate = self._address(_Truncate(on_truncate))
        ours.xSync = self._address(_Sync(on_sync))
        ours.xClose = self._address(_Close(on_close))
        self._methods[usual] = ours
        return ours


def _applied(content: bytearray, changes: list[tuple[int, bytes | None]]) -> bytearray:
    result = bytearray(content)
    for offset, data in changes:
        if data is None:
            del result[offset:]
            continue
        if len(result) < offset:
            result.extend(bytes(offset - len(result)))
        result[offset : offset + len(data)] = data
    return result
