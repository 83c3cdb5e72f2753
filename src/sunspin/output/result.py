"""The accessor of every result: ``.sunspin.summary()``, ``.sunspin.plot()``, ``.sunspin.at(times)``, ``.sunspin.save(folder)``.

``attrs["kind"]`` of a result names its kind. :mod:`sunspin.output.kinds` defines the kinds and is imported at the first use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from itertools import islice, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.extras import missing_packages, require_extra
from sunspin.base.provenance import clock_notes
from sunspin.compute.pool import EndedError, process_pool

if TYPE_CHECKING:
    from sunspin.compute.helper import Helper
    from sunspin.output.kind import Context, Drawing, Kind, Picture, Summary


@xr.register_dataset_accessor("sunspin")
@xr.register_dataarray_accessor("sunspin")
@xr.register_datatree_accessor("sunspin")
class Result:
    """Summary, figures and files of a result of sunspin: the accessor ``.sunspin`` of Dataset, DataArray and DataTree."""

    def __init__(self, data: Any) -> None:
        self._data = data

    @property
    def _kind(self) -> Kind:
        """Kind of the result, whose module is imported at its first use; raises `InputError` if it has none."""
        from sunspin.output.kind import KINDS
        from sunspin.output.kinds import MODULES

        name = self._data.attrs.get("kind")
        if not isinstance(name, str) or name not in MODULES:
            why = f'attrs["kind"] is {name!r}' if name is not None else 'it has no attrs["kind"]'
            what = f"this {type(self._data).__name__} is no result of sunspin: {why}"
            do = f"use a result as sunspin returns it, of kind {', '.join(MODULES)}"
            raise InputError(what, do=do)
        import_module(f"sunspin.output.kinds.{MODULES[name]}")
        return KINDS[name]

    def pictures(self, command: str, context: Context) -> list[Picture]:
        """Return the figures that `command` writes of this result, drawn; none if it is no result of that command.

        Data of a results folder may be no result of its command, such as the samples in a folder of `rates`.
        """
        from sunspin.output.kinds import MODULES

        is_result = self._data.attrs.get("kind") in MODULES and self._kind.command == command
        return draw(self._data, context) if is_result else []

    def summary(self) -> Summary:
        """Return the main numbers as a dict of plain data; ``print()`` shows the text that the command line prints."""
        summary = self._kind.summary(self._data)
        changes = str(self._data.attrs.get("changes", "")).splitlines()  # of the vehicle, by --set
        if notes := clock_notes(self._data):
            summary["clock_notes"] = notes
            for lines in (summary.lines, summary.sentences):
                lines += [f"  {note}" for note in notes]
        if changes:
            summary["changes"] = changes
            for lines in (summary.lines, summary.sentences):
                lines[:0] = [
                    f"Changed for this run: {change}" for change in changes
                ]  # at the begin
        return summary

    def plot(self, name: str | None = None, *, telemetry: xr.Dataset | None = None) -> Any:
        """Draw a figure of the result.

        Parameters
        ----------
        name : str, optional
            Name of the figure; default: the first one of this kind of result.
        telemetry : Dataset of `read_telemetry`, optional
            The samples that the result was computed from; some figures show them too.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InputError
            This kind of result has no figure, or none of this name, or the packages that draw are not installed.
        """
        from sunspin.output.kind import Context

        require_extra("pictures", "a figure")
        context = Context(telemetry)
        drawings = {drawing.name: drawing for drawing in self._kind.drawings(self._data, context)}
        if not drawings:
            what = f"a result of kind {self._data.attrs['kind']!r} has no figure"
            raise InputError(what, do="print its summary()")
        if name is not None and name not in drawings:
            do = f"known: {', '.join(drawings)}"
            raise InputError("there is no figure of this name", got=name, do=do)
        return drawings[name or next(iter(drawings))].make()

    def at(self, times: Any) -> xr.Dataset:
        """Return attitude and rate of a result of `rates` or `propagate` at any times; NaN outside its passes.

        Parameters
        ----------
        times : (n)
            Seconds from the epoch of the result, or UTC times such as "2026-01-31T12:00:00Z".

        Returns
        -------
        xarray.Dataset
            Over `time`: `B_from_N`, `omega_B`, `pass_of` (-1 outside all passes); see
            :func:`sunspin.output.export.motion_at`.

        Raises
        ------
        InputError
            The result holds no attitude, a time cannot be read, or the attitudes are too far apart to interpolate.
        """
        from sunspin.output.export import motion_at

        return motion_at(self._data, times)

    def save(
        self,
        folder: str | Path,
        *,
        vehicle: Any = None,
        telemetry: xr.Dataset | None = None,
        command: str = "",
        also: Mapping[str, Any] | None = None,
        lines: Sequence[str] = (),
        helper: Helper | None = None,
    ) -> Path:
        """Write a results folder: NetCDF, tables, figures as PNG and SVG, `summary.json`; `sunspin report` makes a page of it.

        Without the packages of ``sunspin[pictures]`` the folder has no figures.

        Parameters
        ----------
        folder : path
            Created if needed; refused if it holds anything but earlier results of the same command.
        vehicle : name of a built-in vehicle or path of a vehicle file, optional
            Copied into the folder, for the page.
        telemetry : Dataset of `read_telemetry`, optional
            Copied into the folder, for the page.
        command : str
            The command line that repeats the run.
        also : dict, optional
            Further entries of `summary.json`.
        lines : list of str, optional
            Further sentences of the summary.
        helper : Helper, optional
            A process that draws the figures while this one writes the data; by default this one draws.

        Returns
        -------
        pathlib.Path
            The folder.

        Raises
        ------
        OutputError
            The folder holds other files, or cannot be written.
        """
        from sunspin.output.figures import write_files
        from sunspin.output.folder import Contents, results_folder, write_data, write_manifest
        from sunspin.output.kind import Context
        from sunspin.output.verdicts import PAGE, find_labels

        kind, context, data = self._kind, Context(telemetry, vehicle), self._data
        path = results_folder(folder, kind.command)
        if helper is not None:
            with suppress(EndedError):
                helper.start(draw, data, context, helper.workers)
        if isinstance(data, xr.DataArray):
            # attributes of a DataArray would be those of its variable, but `kind` must be one of the file
            attrs = {key: value for key, value in data.attrs.items() if key != "units"}
            data = data.to_dataset().assign_attrs(attrs)
        main = {kind.main: data} if kind.main else {}
        contents = Contents(
            data=main | dict(kind.datasets(data, context)),
            tables=list(kind.tables(self._data)),
            vehicle=vehicle,
            telemetry=telemetry,
            synthetic=bool(data.attrs.get("synthetic")),
        )
        write_data(path, contents)
        try:
            pictures = draw(self._data, context) if helper is None else helper.result()
        except EndedError:  # no reason to lose the result
            pictures = draw(self._data, context)
        for picture in pictures:
            write_files(picture.files, path, picture.name)
        inputs = []
        if telemetry is not None and "sha256" in telemetry.attrs:
            file, digest = (str(telemetry.attrs[key]) for key in ("file", "sha256"))
            inputs = [{"what": "telemetry", "file": file, "sha256": digest}]
        summary = self.summary()
        # the first sentence is the verdict, so further ones of the command follow it
        verdict, others = summary.sentences[:1], summary.sentences[1:]
        # without the indents and alignment of the console
        sentences = [" ".join(text.split()) for text in (*verdict, *lines, *others, *summary.notes)]
        entries = {**summary, **(also or {})}
        entries |= {"sentences": sentences, "command": command, "inputs": inputs}
        if labels := find_labels(kind.command, [*summary.lines, *sentences]):
            entries["explained"] = [f"{PAGE}#{label}" for label in labels]
        write_manifest(path, entries, replace(contents, figures=pictures))
        return path


def prepare_to_draw(kinds: str) -> None:
    """Import what draws results of these kinds, a module of :mod:`sunspin.output.kinds`, and load all that is used first."""
    from sunspin.output.figures import load

    load()
    import_module(f"sunspin.output.kinds.{kinds}")


def draw(data: Any, context: Context, workers: int = 1) -> list[Picture]:
    """Return all figures of a result, drawn by up to `workers` processes; none without the packages of ``sunspin[pictures]``."""
    if missing_packages("pictures"):
        return []
    drawings = list(data.sunspin._kind.drawings(data, context))
    with process_pool(min(workers, len(drawings))) as pool:
        if pool is None:  # fewer than two workers
            return [_drawn(drawing, data) for drawing in drawings]
        # a drawing holds functions and cannot be sent to a process: each process makes the drawing of its number again
        numbers = range(len(drawings))
        return list(pool.map(_draw_one, repeat(data), repeat(context), numbers))


def _draw_one(data: Any, context: Context, number: int) -> Picture:
    """Return the figure of the drawing with this number."""
    drawings = data.sunspin._kind.drawings(data, context)
    return _drawn(next(islice(drawings, number, None)), data)


def _drawn(drawing: Drawing, data: Any) -> Picture:
    """Return the figure of a drawing, with its caption; that of synthetic telemetry says so."""
    from sunspin.output.figures import render
    from sunspin.output.kind import Picture, synthetic_words

    remark = synthetic_words(bool(data.attrs.get("synthetic")))
    return Picture(drawing.name, drawing.alt, drawing.caption + remark, render(drawing.make()))
