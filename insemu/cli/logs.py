"""Static logs for the commands that take one: a log's own file, or a recording whose sensor was at rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from insemu.formats import Log


def open_log(file: str, rate_hz: float | None = None, columns: Sequence[str] | None = None) -> Log:
    """Read a static log; of a recording at rest the IMU is the log.

    Parameters
    ----------
    file : str
        Path of the log or recording.
    rate_hz : float, optional
        Sampling rate of a log that does not say it, Hz.
    columns : sequence of str, optional
        Names of columns or axes to keep.

    Raises
    ------
    InputError
        See :func:`insemu.formats.read_log`; a recording that moves.
    """
    from insemu import formats
    from insemu.errors import InputError
    from insemu.gap.data import at_rest

    path = Path(file)
    if not path.exists() or not formats.holds_recording(path):
        return formats.read_log(path, rate_hz=rate_hz, columns=columns)
    recording = formats.read_recording(path)
    if recording.gnss is not None and not at_rest(recording):
        raise InputError("is a recording that moves; expected a static log (sensor at rest)", where=file)
    return Log.of_imu(recording.imu, str(path)).select(columns)


def column_names(texts: Sequence[str] | None) -> list[str] | None:
    """Names of ``-c gx,gy -c gz`` one by one; None where no column is asked for."""
    return [name.strip() for text in texts or [] for name in text.split(",") if name.strip()] or None
