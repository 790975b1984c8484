"""What holds throughout a recording has names in words."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.app.record.log import Log
from ffmap.app.record.whole_run import log_warnings
from ffmap.blueprints import entities
from tests.app.record.recordings import start, static, vectors


def test_curves_and_legends_have_names_in_words_with_their_units(recording):
    found = static(recording)
    for path, (name, _) in entities.SERIES.items():
        assert found[path]["names"] == [[name]]
        assert "_" not in name
    units = {"ranges/scatter_mm": "mm", "ranges/measured_alone_percent": "%", "milliseconds/reading": "ms"}
    for series, unit in units.items():
        assert entities.SERIES[f"/metrics/{series}"][0].endswith(f", {unit}")
    dots, names = (found[f"{entities.LABEL_LEGEND}/{part}"] for part in ("dots", "names"))
    assert names["labels"][0] == [name for name, _ in entities.LABEL_LEGEND_ENTRIES]
    for part in (dots, names):
        places = vectors(part["positions"][0])
        assert np.all(np.diff(places[:, 0]) > 0)
    colors = dots["colors"][0]
    assert colors == [(r << 24) | (g << 16) | (b << 8) | 255 for _, (r, g, b) in entities.LABEL_LEGEND_ENTRIES]
    # Each label's own colour is explained.
    shown = {color for _, color in entities.LABEL_LEGEND_ENTRIES}
    assert shown == {entities.CLASSES[label][1] for label in Label}


@pytest.mark.parametrize(("warnings", "text"), [([], "None."), (["no floor", "no clock"], "- no floor\n- no clock")])
def test_warnings_of_the_whole_run_are_a_text(tmp_path, warnings, text):
    recording = start(tmp_path, "run-12")
    log_warnings(Log(recording.stream), warnings)
    recording.finish()
    assert static(tmp_path / "recording.rrd")[entities.WARNINGS]["text"] == [[text]]
