"""Draw the figure of docs/posterior.md: python docs/posterior_figures.py POSTERIOR_FOLDER

POSTERIOR_FOLDER: of `sunspin posterior philae --predict 15:34:04,16:20,17:25 --out POSTERIOR_FOLDER`.
"""

import sys
import tomllib
from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.cases import load_case
from sunspin.dynamics.ensemble import Rows
from sunspin.estimate.posterior.model import model
from sunspin.estimate.posterior.predict import predictions, run_to
from sunspin.landing.predictions import collision_time_s
from sunspin.output.kinds.predictions import predicted_figure

IMAGES = Path(__file__).parent / "images"


def true_motion(case, times_s):
    """What the twin really did at times before its collision, and after it, as the posterior's predictions have it."""
    truth = tomllib.loads((case.folder / "twin_truth.toml").read_text("utf-8"))
    blow = collision_time_s(case.vehicle, case.telemetry.attrs["epoch_utc"])
    start = Rows(*(np.array([truth[key]]) for key in ("omega_B", "sun_B", "wheel_speed_rad_s")))
    after = Rows(
        *(
            np.array([truth[f"collision_{key}"]])
            for key in ("omega_after_B", "sun_B", "wheel_speed_after_rad_s")
        )
    )
    parts = []
    for t in times_s:
        rows, begin = (after, blow) if t > blow else (start, truth["t_s"])
        parts.append(run_to(case.vehicle, rows, [t - begin]))
    run = {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}
    return predictions(model(case.vehicle, None, 1.0)[0], start, run, times_s)


def main(posterior_folder):
    case = load_case("philae")
    tree = xr.open_datatree(Path(posterior_folder) / "posterior.nc").load()
    found = tree["predictions"].to_dataset()
    labels = [str(label).removeprefix("2014-11-12T") for label in found["asked"].values]
    truth = true_motion(case, found["predicted_s"].values)
    predicted_figure(found, labels, truth).savefig(IMAGES / "posterior_predicted.png", dpi=80)


if __name__ == "__main__":
    main(sys.argv[1])
