"""Parameters against time while they are being estimated."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from oed_sysid.errors import DataError
from oed_sysid.results import LiveParameters, plot_history


class Clock:
    """A wall clock that stands where it is set."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        """Return the time, s."""
        return self.now


def fed(n: int, **settings: object) -> LiveParameters:
    """A plot after ``n`` samples of a K that settles at 2."""
    live = LiveParameters(["K"], units={"K": "1/s"}, **settings)  # type: ignore[arg-type]
    for k in range(1, n + 1):
        live.update(float(k), {"K": 2.0 + 1.0 / k}, {"K": 1.0 / k})
    return live


def test_band_is_196_standard_errors() -> None:
    """The band reaches 1.96 standard errors to either side of the estimate."""
    times = np.arange(3.0)
    ax = plot_history(times, np.full(3, 5.0), np.full(3, 2.0), name="Z_w", unit="kg/s")
    corners = ax.collections[0].get_paths()[0].vertices
    assert corners[:, 1].min() == pytest.approx(5.0 - 3.92)
    assert corners[:, 1].max() == pytest.approx(5.0 + 3.92)
    assert "Z_{w}" in ax.get_ylabel()
    assert "kg/s" in ax.get_ylabel()
    plt.close(ax.figure)


def test_drawing_is_throttled_by_the_clock() -> None:
    """A thousand updates within ten seconds draw ten times at one per second."""
    clock = Clock()
    live = LiveParameters(["K"], every=1.0, clock=clock)
    for k in range(1000):
        clock.now = k / 100.0
        live.update(float(k), {"K": 1.0})
    assert live.n_drawings == 10
    assert live.n_samples == 1000


def test_curve_shows_all_samples_once_drawn() -> None:
    """After a last drawing the curve holds every sample, the skipped ones too."""
    live = fed(50, every=1e9)
    assert len(live.figure.axes[0].lines[0].get_xdata()) == 1
    live.draw()
    line = live.figure.axes[0].lines[0]
    assert np.allclose(line.get_ydata(), 2.0 + 1.0 / np.arange(1, 51))


def test_file_is_kept_up_to_date(tmp_path: Path) -> None:
    """Without a screen the picture is on disk after every drawing."""
    file = tmp_path / "live.png"
    fed(3, file=file, every=0.0)
    with Image.open(file) as picture:
        assert picture.format == "PNG"
        assert picture.width > 400


def test_animation_has_the_frames(tmp_path: Path) -> None:
    """The GIF has as many different pictures as were asked for."""
    path = tmp_path / "live.gif"
    fed(20, every=1e9).animate(path, frames=5)
    with Image.open(path) as picture:
        assert picture.n_frames == 5


def test_early_wild_estimates_do_not_set_the_scale() -> None:
    """The axis shows the later half, so that the first samples do not flatten it."""
    live = LiveParameters(["K"], every=1e9)
    for k in range(40):
        live.update(float(k), {"K": 1e6 if k < 3 else 2.0}, {"K": 0.1})
    live.draw()
    low, high = live.figure.axes[0].get_ylim()
    assert 1.0 < low < 2.0 < high < 3.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda live: live.update(0.0, {"K": 1.0}), "not later"),
        (lambda live: live.update(9.0, {"T": 1.0}), "no parameter 'T'"),
        (lambda _: LiveParameters([]), "at least one"),
        (lambda _: LiveParameters(["K"]).animate("x.gif"), "nothing to animate"),
    ],
)
def test_mistakes_are_named(call, words: str) -> None:  # type: ignore[no-untyped-def]
    """Wrong order, wrong names and nothing to show are said, not drawn."""
    live = fed(3, every=1e9)
    with pytest.raises(DataError, match=words):
        call(live)
