"""Layout of a recording in the rerun viewer."""

from __future__ import annotations

from typing import Any, Final

from servo_twin.view import scene

_WINDOW: Final = 15.0  # displayed past in the plots [s]


def blueprint() -> Any:
    """Columns per axis with position, speed, current and residual; next to them shafts, path, states and log."""
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import TextLogColumnKind

    relative = rrb.TimeRangeBoundary.cursor_relative
    start, end = relative(seconds=-_WINDOW), relative(seconds=0.0)
    time_axis = rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))
    window = rrb.VisibleTimeRange(scene.TIMELINE, start=start, end=end)

    def plot(name: str, origin: str, contents: list[str]) -> Any:
        return rrb.TimeSeriesView(
            name=name,
            origin=origin,
            contents=contents,
            axis_x=time_axis,
            time_ranges=[window],
            plot_legend=rrb.Corner2D.LeftTop,
        )

    columns = []
    for axis, name in scene.axes():
        origin = f"/plot/{name}"
        plots = [plot(f"{name}: {q.title} [{q.unit}]", origin, [f"+ {origin}/{q.name}/**"]) for q in scene.QUANTITIES]
        residuals = [
            plot(f"{name}: residual {field} [{unit}]", origin, [f"+ {scene.residual_entity(axis, field)}"])
            for field, unit in scene.RESIDUALS.items()
        ]
        residuals += [
            plot(f"{name}: {extra.title} [{extra.unit}]", origin, [f"+ {origin}/{extra.name}/**"])
            for extra in scene.EXTRAS
        ]
        origin = f"/plot/{name}/estimate"
        load = f"{origin}/load/**"
        residuals += [
            plot(
                f"{name}: estimates [relative to the twin]",
                origin,
                [f"+ {origin}/**", f"- {load}", f"- {origin}/encoder_angle/**"],
            ),
            plot(f"{name}: load [N m]", origin, [f"+ {load}"]),
        ]
        tabs = rrb.Tabs(*residuals, active_tab=0)
        # Rerun labels powers of ten only, and in a plot of 150 points often none but 0: residuals are small.
        columns.append(rrb.Vertical(*plots, tabs, row_shares=[*(4 for _ in plots), 6], name=name))
    shafts = rrb.Spatial3DView(
        name="shafts",
        origin="/shafts",
        background=(24, 26, 30),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=[0.13, -0.03, 0.43], look_target=[0.13, 0.0, 0.0], eye_up=[0, 1, 0]),
    )
    first, second = (name for _, name in scene.axes())
    path = rrb.Spatial2DView(
        name=f"path: {second} over {first}",
        origin="/path",
        time_ranges=[rrb.VisibleTimeRange(scene.TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=end)],
    )
    states = rrb.StateTimelineView(name="states", origin="/state", time_view=time_axis)
    kinds = [TextLogColumnKind.LogLevel, TextLogColumnKind.Body]
    log = rrb.TextLogView(name="log", origin="/log", columns=rrb.TextLogColumns(text_log_columns=kinds))
    bursts = [
        rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.Corner2D.LeftTop)
        for name, origin in (
            ("bursts of the recorder", f"/{scene.BURST}"),
            ("bursts: board - twin", scene.BURST_RESIDUAL),
        )
    ]
    views = rrb.Vertical(shafts, path, states, rrb.Tabs(log, *bursts, active_tab=0), row_shares=[3, 3, 4, 3])
    return rrb.Blueprint(
        rrb.Horizontal(*columns, views, column_shares=[3, 3, 2]),
        rrb.TimePanel(state="collapsed", timeline=scene.TIMELINE, play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )
