"""Recording of a measured loop for the rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from servo_measurement.bode import Bode
from servo_measurement.bode_report import COLUMNS, rows, text
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.rerun_file import recording_file

from servo_bridge.bursts.rerun_log import entity_of, send_curve

FREQUENCY: Final = "frequency"
"""Timeline with one second per hertz."""

LOG_FREQUENCY: Final = "log_frequency"
"""Timeline with one second per decade, from 1 Hz."""

_CURVES: Final = (
    ("gain", "measured", "gain [dB]"),
    ("gain", "predicted", "predicted gain [dB]"),
    ("phase", "measured", "phase [degrees]"),
    ("phase", "predicted", "predicted phase [degrees]"),
    ("coherence", "measured", "coherence"),
)


def write_recording(bode: Bode, path: Path) -> None:
    """Write gain, phase and coherence over frequency (linear and logarithmic timeline), and the figures as text.

    Raises
    ------
    RecordingError
        If rerun is not installed.
    """
    with recording_file("servo-bode", path) as recording:
        import rerun as rr
        import rerun.blueprint as rrb

        base = ["bode", axis_name(bode.settings.axis), bode.settings.loop.name]
        ends = rrb.TimeRangeBoundary.infinite()
        whole = [rrb.VisibleTimeRange(line, start=ends, end=ends) for line in (LOG_FREQUENCY, FREQUENCY)]
        views = [
            rrb.TimeSeriesView(name=quantity, origin=entity_of([*base, quantity]), time_ranges=whole)
            for quantity in ("gain", "phase", "coherence")
        ]
        figures = entity_of([*base, "figures"])
        page = rrb.TextDocumentView(name="figures", origin=figures)
        recording.send_blueprint(
            rrb.Blueprint(
                rrb.Vertical(*views, page, row_shares=[3, 3, 1, 1]),
                rrb.TimePanel(state="collapsed", timeline=LOG_FREQUENCY),
                auto_views=False,
            )
        )
        columns = dict(zip(COLUMNS, rows(bode).T, strict=True))
        for name in ("gain [dB]", "phase [degrees]"):
            columns[name][~bode.response.good] = np.nan  # gap: these points are not valid
        frequency = columns["frequency [Hz]"]
        for quantity, which, name in _CURVES:
            entity = entity_of([*base, quantity, which])
            recording.log(entity, rr.SeriesLines(names=name), static=True)
            for line, position in ((LOG_FREQUENCY, np.log10(frequency)), (FREQUENCY, frequency)):
                send_curve(recording, entity, rr.TimeColumn(line, duration=position), columns[name])
        recording.log(figures, rr.TextDocument(text(bode)), static=True)
