"""Pictures and HTML reports: the only part of the package that draws.

Every ``plot_x(result, ax=None)`` draws on the given axes, or on those of a new
figure, and returns them; nothing is shown and no global setting is touched.
``figure_x`` compose several, and ``result.document().write("file.html")`` makes a report in
one file: the document of the result with its figures drawn.
"""

from oed_sysid.results.design_plots import (
    figure_card,
    figure_design,
    figure_programme,
    plot_accuracy,
    plot_orders,
    plot_sensitivity,
    plot_tracks,
)
from oed_sysid.results.estimator_plots import (
    figure_benchmark,
    plot_history,
    plot_waterfall,
)
from oed_sysid.results.fit_plots import (
    figure_fit,
    figure_frequency,
    figure_predictions,
    figure_whiteness,
    plot_autocorrelation,
    plot_comparison,
    plot_correlation,
    plot_ellipses,
    plot_intervals,
    plot_polar,
    plot_prediction,
    plot_prediction_error,
    plot_profile,
)
from oed_sysid.results.improvement_plots import (
    figure_diagnosis,
    figure_force,
    plot_error_fall,
    plot_force_against,
    plot_force_found,
    plot_located,
    plot_ranking,
    plot_residual_force,
)
from oed_sysid.results.page import Picture, numbers_page, style_sheet
from oed_sysid.results.record_plots import (
    figure_check,
    figure_record,
    plot_balance,
    plot_balances,
    plot_track,
    plot_zigzag,
)
from oed_sysid.results.style import finding, model_style, new_figure, save_figure
from oed_sysid.runtime.display import Figure, Report, Section, Table
from oed_sysid.runtime.version import exported

__all__ = exported(globals())
