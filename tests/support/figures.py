"""Figures in tests: empty ones where a test is about something else (drawing takes longest), and legends that cover curves."""

from matplotlib.figure import Figure

from sunspin.output.figures import lay_out


def frame(figure: Figure) -> Figure:
    """Return an empty drawing of a figure's size."""
    return Figure(figsize=figure.get_size_inches())


def blank(_: Figure) -> dict[str, bytes]:
    """Return the files of a figure, without a drawing in them."""
    return {
        suffix: b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="6"/>'
        for suffix in ("svg", "png")
    }


def covered(figure: Figure) -> list[str]:
    """Return titles of the flat axes whose legend stands on points of a curve, on marks or on an edge of a histogram."""
    lay_out(figure).draw_without_rendering()
    found = []
    for axes in (
        axes for axes in figure.axes if axes.name != "3d" and axes.get_legend() is not None
    ):
        box = axes.get_legend().get_window_extent()
        points = [
            line.get_transform().transform(line.get_xydata())
            for line in axes.lines
            if len(line.get_xdata()) > 2
        ]
        points += [
            patch.get_transform().transform(patch.get_path().vertices) for patch in axes.patches
        ]
        clouds = [one for one in axes.collections if len(one.get_offsets()) > 1]
        points += [cloud.get_offset_transform().transform(cloud.get_offsets()) for cloud in clouds]
        found += (
            [axes.get_title()]
            if any(box.contains(*point) for some in points for point in some)
            else []
        )
    return found
