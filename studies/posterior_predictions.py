"""Predictions of the posterior for the built-in telemetry of Philae, compared with the motion that the telemetry was made from.

    python -m studies.posterior_predictions OUT POSTERIOR

POSTERIOR is the folder of `sunspin posterior philae --prior max_rate_rad_s=0.33 --predict 15:34:04,16:20,17:25 --out POSTERIOR`.
OUT holds the figure, posterior_predicted.png; that of docs/posterior.md is in docs/images.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.cases import Case, load_case
from sunspin.dynamics.batch import Rows
from sunspin.estimate.lander.predict import DrawnMotions, PredictedStates, predictions
from sunspin.landing.predictions import collision_time_s
from sunspin.output.kinds.predictions import predicted_figure
from validation.campaign import command, rows_folder, study_parser


def true_motion(case: Case, times_s: np.ndarray) -> xr.Dataset:
    """Return the true motion at times (s from the epoch), before and after the collision, as a Dataset of predictions."""
    truth = tomllib.loads((case.folder / "twin_truth.toml").read_text("utf-8"))
    collision = collision_time_s(case.vehicle, case.telemetry.attrs["epoch_utc"])
    assert collision is not None  # Philae's vehicle file states one
    start_keys = ("omega_B", "sun_B", "wheel_speed_rad_s")
    after_keys = ("omega_after_B", "sun_B", "wheel_speed_after_rad_s")
    start = Rows(*(np.array([truth[key]]) for key in start_keys))
    after = Rows(*(np.array([truth[f"collision_{key}"]]) for key in after_keys))
    parts = []
    for t in times_s:
        rows, begin_s = (after, collision) if t > collision else (start, truth["t_s"])
        parts.append(DrawnMotions(case.vehicle, rows, begin_s).at([t]))
    carried = PredictedStates(*(np.concatenate(part, axis=1) for part in zip(*parts, strict=True)))
    return predictions(DrawnMotions(case.vehicle, start, truth["t_s"]), carried, times_s)


def read_predictions(folder: Path) -> xr.Dataset:
    """Return the predictions of a posterior's folder.

    Raises
    ------
    InputError
        The folder holds no posterior, or one without predictions.
    """
    path = folder / "posterior.nc"
    if not path.is_file():
        do = "run `sunspin posterior philae --predict ... --out` for this folder"
        raise InputError("there is no posterior here", do=do, where=str(path))
    tree = xr.open_datatree(path).load()
    if "predictions" not in tree:
        do = "run `sunspin posterior` with --predict"
        raise InputError("the posterior has no predictions", do=do, where=str(path))
    return tree["predictions"].to_dataset()


@command
def main(arguments: list[str] | None = None) -> None:
    parser = study_parser("posterior_predictions", __doc__)
    parser.add_argument("out", type=Path, help="folder of the figure")
    parser.add_argument("posterior", type=Path, help="folder of `sunspin posterior philae`")
    given = parser.parse_args(arguments)
    predicted = read_predictions(given.posterior)
    labels = [str(label).removeprefix("2014-11-12T") for label in predicted["asked"].values]
    truth = true_motion(load_case("philae"), predicted["predicted_s"].values)
    path = rows_folder(given.out) / "posterior_predicted.png"
    predicted_figure(predicted, labels, truth).savefig(path, dpi=80)
    print(f"written: {path}")


if __name__ == "__main__":
    sys.exit(main())
