"""Any folder: its files are read one by one, and what they hold makes one recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from insemu.errors import InputError
from insemu.formats.table import Probe, Reader, Table, reader_of, register

#: Files that a folder of one recording may have; more are a collection.
_MOST = 40


def _sniff(probe: Probe) -> bool:
    return probe.path.is_dir()


def _read(path: Path, settings: Mapping[str, str]) -> list[Table]:
    files = sorted(
        p for p in path.rglob("*") if p.is_file() and not p.name.startswith(".") and not p.name.endswith(".yaml")
    )
    if len(files) > _MOST:
        raise InputError(
            f"holds {len(files)} files; name the one with the IMU, and --gnss and --truth", where=str(path)
        )
    tables: list[Table] = []
    holding: dict[str, str] = {}
    for file in files:
        reader = reader_of(file)
        if reader is None:
            continue
        try:
            found = reader.read(file, settings)
        except InputError:
            continue  # notes and pictures next to the data
        for table in found:
            role = next((r for r in ("gyro", "rpy", "quaternion", "lat", "ecef") if r in table.map.picks), "")
            if role in ("gyro", "lat") and role in holding:
                raise InputError(
                    f"holds several recordings ({holding[role]}, {file.name}); name the file with the IMU, and --gnss and --truth",
                    where=str(path),
                )
            holding[role] = file.name
            tables.append(table)
    if not tables:
        raise InputError("holds no file that a reader knows", where=str(path))
    return tables


register(Reader("folder of files", _sniff, _read, rank=9))
