"""The seven depth metrics: their names, which way is better, and their units."""

from __future__ import annotations

TITLES = {
    "abs_rel": "Abs Rel",
    "sq_rel": "Sq Rel",
    "rmse": "RMSE",
    "rmse_log": "RMSE log",
    "a1": "δ<1.25",
    "a2": "δ<1.25²",
    "a3": "δ<1.25³",
}
BEST = {TITLES[key]: "max" if key in ("a1", "a2", "a3") else "min" for key in TITLES}
WITH_UNITS = TITLES | {"sq_rel": "Sq Rel (m)", "rmse": "RMSE (m)"}
