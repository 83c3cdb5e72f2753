"""What moved between two results folders: rows of the study, rates of passes, a posterior, outcomes, each against its error."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, SunspinError, sentence
from sunspin.base.netcdf import read_groups
from sunspin.base.provenance import provenance
from sunspin.base.untrusted import is_own, read_bytes
from sunspin.landing.tally import quantity
from sunspin.output.folder import MARKER, maker
from sunspin.output.text import number_text

MAX_SUMMARY_BYTES = 20_000_000

COMPARED = ("reproduce", "rates", "posterior", "outcomes")
"""Commands whose results can be compared."""

INTERVAL_SIGMAS = 1.645
"""Half of a 90 % interval, in sigmas."""

ROUNDING = 1e-12
"""Part of a value by which it may differ and is the same."""


class Moved(NamedTuple):
    """One quantity in both results.

    `a`, `b`: its values as text; `change`: the largest of B less A over its numbers; `error`: what that is held against (NaN: none
    known), and `of`: what error it is; `size`: change over error, or without one over the larger value; `words`: what else changed.
    """

    name: str
    what: str
    a: str
    b: str
    unit: str
    change: float
    error: float
    of: str
    size: float
    words: str = ""

    @property
    def beyond(self) -> bool:
        """Whether it moved by more than its error; without one, whether it changed at all."""
        return bool(self.size > 1) if np.isfinite(self.error) else bool(self.size > 0)


def compare(a: str | Path, b: str | Path) -> xr.Dataset:
    """What moved from one results folder to another of the same command: `reproduce`, `rates`, `posterior` or `outcomes`.

    Parameters
    ----------
    a, b : path
        Folders that the command wrote.

    Returns
    -------
    xarray.Dataset
        Over `row`, the largest move first: `change` (B less A, unit in `unit`), `error` it is held against (of the rows of
        `reproduce` the half width of the wider of the two intervals; of rates, medians and shares of runs one sigma, of both
        together; NaN where none is known), `size` (change over error; without one over the value), `beyond`, both values as
        text, and in `words` what changed in agreement or verdict; attrs: rows that one alone has (`only_a`, `only_b`), sentences
        of its conclusions that the other has not (`said_a`, `said_b`). `.sunspin.plot()` draws it, `.sunspin.save(folder)`
        writes it.

    Raises
    ------
    InputError
        Folders of different commands, of others than these, or with nothing in common.
    """
    folders = [Path(a), Path(b)]
    commands = [_command(folder) for folder in folders]
    if commands[0] != commands[1]:
        got = f"sunspin {commands[0]} and sunspin {commands[1]}"
        raise InputError(
            sentence(
                "results of different commands have nothing to compare",
                got=got,
                do="give two of the same",
            )
        )
    if commands[0] not in COMPARED:
        known = ", ".join(COMPARED)
        raise InputError(
            sentence(
                "results of this command cannot be compared",
                got=f"sunspin {commands[0]}",
                do=f"known: {known}",
            )
        )
    said = [_summary(folder) for folder in folders]
    find = {"reproduce": _rows, "rates": _passes, "posterior": _posterior, "outcomes": _outcomes}[
        commands[0]
    ]
    try:
        found = sorted(
            find(said[0], said[1], *folders),
            key=lambda one: (not np.isfinite(one.error), -one.size),
        )
        compared = _dataset(found, commands[0], folders, said)
    except SunspinError:
        raise
    except (TypeError, KeyError, ValueError, AttributeError, IndexError, OverflowError) as error:
        what = f"a summary holds something else than `sunspin {commands[0]}` writes ({type(error).__name__}: {error})"
        raise InputError(sentence(what, got=f"{a} and {b}", do="run the commands again")) from None
    if not found:
        got = f"{a} and {b}"
        raise InputError(
            sentence(
                "the two results have nothing in common",
                got=got,
                do="compare results of the same data",
            )
        )
    return compared


def _command(folder: Path) -> str:
    if not is_own(folder / MARKER):
        raise InputError(
            sentence(
                "this is no results folder of sunspin", got=str(folder), do="give what --out named"
            )
        )
    return maker(folder / MARKER)


def _summary(folder: Path) -> dict[str, Any]:
    do = "run the command again"
    try:
        found = json.loads(
            read_bytes(folder / "summary.json", MAX_SUMMARY_BYTES, "summary", InputError, do)
        )
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            sentence("the summary cannot be read", do=do, where=str(folder / "summary.json"))
        ) from None
    if not isinstance(found, dict):
        raise InputError(
            sentence(
                "the summary is not that of a result", do=do, where=str(folder / "summary.json")
            )
        )
    return found


# ---------------------------------------------------------------------------------------------------------------- the study's rows


def _rows(a: dict[str, Any], b: dict[str, Any], *_: Path) -> Iterator[Moved]:
    mine, theirs = ({str(row.get("id")): row for row in _list(said, "figures")} for said in (a, b))
    for name in mine:
        if name in theirs and not name.startswith("figure_"):
            yield _row(mine[name], theirs[name])


def _row(a: dict[str, Any], b: dict[str, Any]) -> Moved:
    ours = [_numbers(row.get("ours")) for row in (a, b)]
    ends = [[_numbers(row.get(key)) for key in ("low", "high")] for row in (a, b)]
    same = ours[0].size > 0 and ours[0].shape == ours[1].shape
    change = _largest(ours[1] - ours[0]) if same else 0.0
    known = all(end.size and end.shape == ends[0][0].shape for pair in ends for end in pair)
    error, of = float("nan"), "none known"
    if known:
        error, of = (
            max(float(np.max(np.abs(high - low))) / 2 for low, high in ends),
            "half of the wider interval",
        )
        moved = max((_largest(ends[1][k] - ends[0][k]) for k in range(2)), key=abs)
        change = max(change, moved, key=abs) if _beyond_ends(ours, ends) else moved
    elif (
        a.get("kind") != "put_in"
        and isinstance(a.get("tolerance"), int | float)
        and a["tolerance"] > 0
    ):
        error, of = float(a["tolerance"]), "tolerance of the row"
    words = [] if a.get("agrees") == b.get("agrees") else [f"{_agreement(a)}, now {_agreement(b)}"]
    if not same and a.get("ours") != b.get("ours"):
        words.append("another value")
    texts = [_shown(row, bool(known)) for row in (a, b)]
    return _moved(
        str(a.get("id")), str(a.get("what")), texts, _unit(a), change, error, of, ours, words
    )


def _beyond_ends(ours: list[np.ndarray], ends: list[list[np.ndarray]]) -> bool:
    """Whether the value of each result lies in its own interval, and one outside of the other's: only then has the value moved.

    What the few motions nearest to the telemetry give may lie outside of what the candidates give, and then scatters by other
    amounts than the interval's width; so does a best delay among many that are as good.
    """
    if any(one.shape != low.shape for one, (low, _) in zip(ours, ends, strict=True)):
        return False
    inside = [[bool(np.all((low <= one) & (one <= high))) for low, high in ends] for one in ours]
    return inside[0][0] and inside[1][1] and not (inside[0][1] and inside[1][0])


def _agreement(row: dict[str, Any]) -> str:
    agrees = row.get("agrees")
    if agrees is None:
        return "uninformative" if row.get("informative") is False else "not judged"
    return "agrees" if agrees else "differs"


def _shown(row: dict[str, Any], interval: bool) -> str:
    text = number_text(row.get("ours"), 4)
    return (
        f"{text} ({number_text(row.get('low'), 4)} to {number_text(row.get('high'), 4)})"
        if interval
        else text
    )


def _unit(row: dict[str, Any]) -> str:
    return "" if row.get("unit") in (None, "1") else str(row["unit"])


# ------------------------------------------------------------------------------------------------------------ passes and posteriors


def _passes(a: dict[str, Any], b: dict[str, Any], *_: Path) -> Iterator[Moved]:
    theirs = _list(b, "passes")
    for mine in _list(a, "passes"):
        other = max(theirs, key=lambda one: _overlap(mine, one), default=None)
        if other is not None and _overlap(mine, other) > 0:
            yield from _pass(mine, other)


def _overlap(a: dict[str, Any], b: dict[str, Any]) -> float:
    """s that two passes have in common."""
    try:
        begin, end = (
            [datetime.fromisoformat(str(one[f"utc_{key}"])) for one in (a, b)]
            for key in ("start", "end")
        )
        return (min(end) - max(begin)).total_seconds()
    except (KeyError, ValueError, TypeError):
        return 1.0 if a.get("pass_id") == b.get("pass_id") else 0.0


def _pass(a: dict[str, Any], b: dict[str, Any]) -> Iterator[Moved]:
    """Rates of both, where they are given for one instant; else their speeds alone."""
    name, best = (
        f"pass {a.get('pass_id')}",
        [_list(one, "modes")[0] for one in (a, b) if _list(one, "modes")],
    )
    if len(best) < 2:
        return
    if _instant(a) == _instant(b):  # an earlier version wrote the same time with other decimals
        a = a | {"utc_at": b.get("utc_at")}
    held = [_held(one) for one in (a, b)]
    of = (
        "the likeliest motion"
        if all(len(modes) == 1 for modes in held)
        else "the likeliest motion, or all where not decided"
    )
    words = [_changed(key, a, b) for key in ("decided", "wiring", "utc_at")]
    words += (
        [f"{len(_list(a, 'modes'))} motions, now {len(_list(b, 'modes'))}"] if _counts(a, b) else []
    )
    words = [word for word in words if word]
    if a.get("utc_at") == b.get("utc_at"):
        for axis in "xyz":
            found = [
                _mixed(
                    modes,
                    f"omega_{axis}_deg_s",
                    [float(one[f"sigma_{axis}_deg_s"]) for one in modes],
                )
                for modes in held
            ]
            what = f"rate about {axis} at {a.get('utc_at')}: {of}"
            yield _sigmas(
                f"{name} omega_{axis}",
                what,
                [one for one, _ in found],
                "deg/s",
                _together([s for _, s in found]),
                words,
            )
            words = []
    ends = [
        [[float(one[f"speed_{end}_deg_s"]) for one in modes] for end in ("low", "high")]
        for modes in held
    ]
    found = [
        _mixed(modes, "speed_median_deg_s", (np.array(high) - low) / 2 / INTERVAL_SIGMAS)
        for modes, (low, high) in zip(held, ends, strict=True)
    ]
    moved = _sigmas(
        f"{name} speed",
        f"angular speed: {of}",
        [one for one, _ in found],
        "deg/s",
        _together([s for _, s in found]),
        words,
    )
    texts = [f"{number_text(min(low), 4)} to {number_text(max(high), 4)}" for low, high in ends]
    yield moved._replace(a=f"{moved.a} ({texts[0]})", b=f"{moved.b} ({texts[1]})")
    weights = [float(one["weight"]) for one in best]
    yield _moved(
        f"{name} weight",
        "weight of the likeliest motion",
        [f"{w:.3f}" for w in weights],
        "",
        weights[1] - weights[0],
        float("nan"),
        "none known",
        [np.array([w]) for w in weights],
        [],
    )


def _instant(one: dict[str, Any]) -> Any:
    """When the rates of a pass are given, as a time where it is one."""
    try:
        return datetime.fromisoformat(str(one.get("utc_at")))
    except ValueError:
        return one.get("utc_at")


def _held(one: dict[str, Any]) -> list[dict[str, Any]]:
    """What is known of a pass: its likeliest motion, or where it is not decided all, as which of them is likeliest is chance."""
    modes = _list(one, "modes")
    return modes if one.get("decided") is False else modes[:1]


def _mixed(modes: list[dict[str, Any]], key: str, sigmas: Any) -> tuple[float, float]:
    """Mean of `key` over motions by their weights, and its sigma: theirs and their spread."""
    weight, value = (np.array([float(mode[name]) for mode in modes]) for name in ("weight", key))
    share = weight / weight.sum()
    mean = float(share @ value)
    return mean, float(np.sqrt(share @ (np.square(sigmas) + (value - mean) ** 2)))


def _counts(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return len(_list(a, "modes")) != len(_list(b, "modes"))


def _changed(key: str, a: dict[str, Any], b: dict[str, Any]) -> str:
    return (
        ""
        if a.get(key) == b.get(key)
        else f"{key} {number_text(a.get(key))}, now {number_text(b.get(key))}"
    )


def _posterior(a: dict[str, Any], b: dict[str, Any], *folders: Path) -> Iterator[Moved]:
    """Medians of the draws of every unknown, in sigmas of both together, and the verdicts."""
    mine, theirs = (_draws(folder / "posterior.nc") for folder in folders)
    words = [_changed("verdict_word", a, b), _changed("verdict", a, b)]
    words = [word for word in words if word][:1]
    for name in mine.data_vars:
        if name in ("mode_id", "log_weight", "log_likelihood_sum") or name not in theirs:
            continue
        values = [_columns(one[name]) for one in (mine, theirs)]
        if values[0].shape[1] != values[1].shape[1] or not all(
            np.issubdtype(each.dtype, np.number) for each in values
        ):
            continue
        unit = str(mine[name].attrs.get("units", "")).replace("rad s-1", "rad/s")
        labels = (
            [f"_{axis}" for axis in "xyz"]
            if values[0].shape[1] == 3
            else [f"_{i}" for i in range(values[0].shape[1])]
        )
        for k, label in enumerate(labels if values[0].shape[1] > 1 else [""]):
            low, middle, high = (
                np.array([np.quantile(each[:, k], q) for each in values])
                for q in (0.159, 0.5, 0.841)
            )
            sigma = _together((high - low) / 2)
            about = str(mine[name].attrs.get("long_name", "")) or f"median of {name}"
            unit_text = "" if unit == "1" else unit
            yield _sigmas(
                f"{name}{label}", about, list(map(float, middle)), unit_text, sigma, words
            )
            words = []


def _columns(values: Any) -> np.ndarray:
    array = np.asarray(values)
    return (
        array.reshape(array.shape[0] * array.shape[1], -1)
        if array.ndim >= 2
        else array.reshape(-1, 1)
    )


def _draws(path: Path) -> xr.Dataset:
    if not is_own(path):
        raise InputError(
            sentence(
                "the results have no posterior.nc",
                do="run the command again",
                where=str(path.parent),
            )
        )
    groups = read_groups(path, str(path), InputError)
    found = groups.get("/posterior")
    if found is None or not found.data_vars:
        raise InputError(
            sentence("this file holds no draws", do="run the command again", where=str(path))
        )
    return found


# ------------------------------------------------------------------------------------------------------------------------ outcomes


def _outcomes(a: dict[str, Any], b: dict[str, Any], *_: Path) -> Iterator[Moved]:
    """Means and shares over the runs of the strategies that both have; with one seed both drew alike, and less is chance."""
    mine, theirs = (said.get("strategies") or {} for said in (a, b))
    for strategy, name in (
        (one, name) for one in mine if one in theirs for name in mine[one] if name in theirs[one]
    ):
        one = quantity(name)
        values, errors = (
            [one.scale * float(said[strategy][name][key]) for said in (mine, theirs)]
            for key in ("value", "error")
        )
        yield _sigmas(
            f"wheels {strategy} {name}", one.text, values, one.unit, _together(errors), []
        )


# -------------------------------------------------------------------------------------------------------------------------- shared


def _together(sigmas: list[float] | np.ndarray) -> float:
    """The sigma of a difference."""
    return float(np.sqrt(np.sum(np.square(sigmas))))


def _sigmas(
    name: str, what: str, values: list[float], unit: str, sigma: float, words: list[str]
) -> Moved:
    error = sigma if np.isfinite(sigma) and sigma > 0 else float("nan")
    texts = [number_text(value, 5) for value in values]
    each = [np.array([value]) for value in values]
    return _moved(
        name,
        what,
        texts,
        unit,
        values[1] - values[0],
        error,
        "one sigma of both together",
        each,
        words,
    )


def _moved(
    name: str,
    what: str,
    texts: list[str],
    unit: str,
    change: float,
    error: float,
    of: str,
    values: list[np.ndarray],
    words: list[str],
) -> Moved:
    if np.isfinite(error) and error > 0:
        size = abs(change) / error
    else:
        error = float("nan")
        largest = max((float(np.max(np.abs(each))) for each in values if each.size), default=0.0)
        size = abs(change) / largest if abs(change) > ROUNDING * largest else 0.0
    size = (
        max(size, 1e-9) if words and not np.isfinite(error) else size
    )  # what changed in words alone did change
    return Moved(name, what, texts[0], texts[1], unit, change, error, of, size, "; ".join(words))


def _largest(difference: np.ndarray) -> float:
    """The one of largest size, with its sign."""
    flat = difference.ravel()
    return float(flat[np.argmax(np.abs(flat))])


def _numbers(value: Any) -> np.ndarray:
    """Finite numbers, or nothing."""
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.zeros(0)
    usable = not isinstance(value, bool | str | None) and found.size and np.all(np.isfinite(found))
    return np.atleast_1d(found) if usable else np.zeros(0)


def _list(said: dict[str, Any], key: str) -> list[dict[str, Any]]:
    found = said.get(key)
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _dataset(
    found: list[Moved], command: str, folders: list[Path], said: list[dict[str, Any]]
) -> xr.Dataset:
    def texts(name: str) -> tuple[str, np.ndarray]:
        return "row", np.array([getattr(one, name) for one in found], dtype=np.str_)

    def numbers(name: str, **about: str) -> tuple[str, np.ndarray, dict[str, str]]:
        return "row", np.array([getattr(one, name) for one in found], dtype=np.float64), about

    variables: dict[str, Any] = {
        name: texts(name) for name in ("what", "a", "b", "unit", "of", "words")
    }
    variables |= {
        "change": numbers("change", long_name="B less A, in the row's unit"),
        "error": numbers("error", long_name="what it is held against, in the row's unit"),
        "size": numbers(
            "size", units="1", long_name="change over error; without an error over the value"
        ),
        "beyond": ("row", np.array([one.beyond for one in found])),
    }
    changed = {
        f"changes_{letter}": "\n".join(map(str, one.get("changes") or ()))
        for letter, one in zip("ab", said, strict=True)
    }
    for letter, mine, other in zip("ab", said, reversed(said), strict=True):
        changed[f"said_{letter}"] = "\n".join(
            one for one in _sentences(mine) if one not in _sentences(other)
        )
        theirs = {row.get("id") for row in _list(other, "figures")}
        changed[f"only_{letter}"] = ", ".join(
            str(row.get("id")) for row in _list(mine, "figures") if row.get("id") not in theirs
        )
    attrs = provenance(
        "comparison",
        command=command,
        folder_a=str(folders[0]),
        folder_b=str(folders[1]),
        same_telemetry=int(_same(*said)),
        synthetic=int(any(bool(one.get("synthetic_telemetry")) for one in said)),
        **changed,
    )
    return xr.Dataset(variables, {"row": texts("name")}, attrs)


def _sentences(said: dict[str, Any]) -> list[str]:
    """What a study concludes, sentence by sentence."""
    found = said.get("headline")
    return [
        one
        for part in (found if isinstance(found, list) else [])
        for one in re.split(r"(?<=\.) (?=[A-Z])", str(part))
    ]


def _same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Whether both are of one telemetry file, by its hash."""
    hashes = [
        {one.get("sha256") for one in _list(said, "inputs") if one.get("what") == "telemetry"}
        for said in (a, b)
    ]
    return bool(hashes[0]) and hashes[0] == hashes[1]
