"""Figures in tests: empty ones where a test is about something else (drawing takes longest), and legends that cover curves."""

from matplotlib.figure import Figure

from sunspin.output.figures import lay_out


def frame(figure: Figure) -> Figure:
    """Return an empty drawing of a figure's size."""
    return Figure(figsize=figure.get_size_inches())


def blank(_: Figure) -> dict[str, bytes]:
    """Return the files of a figure, without a drawing in them."""
    return dict.fromkeys(
        ("svg", "png"), b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="6"/>'
    )


def covered(figure: Figure) -> list[str]:
    """Return titles of the flat axes whose legend stands on points of a curve, on marks or on an edge of a histogram."""
    lay_out(figure).draw_without_rendering()
    found = []
    for axes in figure.axes:
        if axes.name == "3d" or axes.get_legend() is None:
            continue
        box = axes.get_legend().get_window_extent()
        lines = [line for line in axes.lines if len(line.get_xdata()) > 2]
        points = [line.get_transform().transform(line.get_xydata()) for line in lines]
        points += [p.get_transform().transform(p.get_path().vertices) for p in axes.patches]
        clouds = [one for one in axes.collections if len(one.get_offsets()) > 1]
        points += [cloud.get_offset_transform().transform(cloud.get_offsets()) for cloud in clouds]
        if any(box.contains(*point) for some in points for point in some):
            found.append(axes.get_title())
    return found
