"""Pictures and HTML reports: the only part of the package that draws.

Every ``plot_x(result, ax=None)`` draws on the given axes, or on those of a new
figure, and returns them; nothing is shown and no global setting is touched.
``figure_x`` compose several, and ``x_page(result).write("file.html")`` makes a
report in one file.
"""

from oed_sysid.report.fit_page import fit_page
from oed_sysid.report.fit_plots import (
    figure_fit,
    figure_whiteness,
    plot_autocorrelation,
    plot_correlation,
    plot_input,
    plot_intervals,
    plot_output,
    plot_residual,
)
from oed_sysid.report.page import Page, Picture, Section, Table
from oed_sysid.report.style import model_style
from oed_sysid.report.track_plots import plot_track, plot_zigzag

__all__ = [
    "Page",
    "Picture",
    "Section",
    "Table",
    "figure_fit",
    "figure_whiteness",
    "fit_page",
    "model_style",
    "plot_autocorrelation",
    "plot_correlation",
    "plot_input",
    "plot_intervals",
    "plot_output",
    "plot_residual",
    "plot_track",
    "plot_zigzag",
]
