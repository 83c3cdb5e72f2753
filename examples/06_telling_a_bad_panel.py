"""A shaded panel, found from sets of lit panels that no Sun direction explains."""

import sunspin as ss

philae = ss.load_case("philae")
health = ss.panel_health(philae.vehicle, philae.telemetry)
for pattern, count in health["impossible"].items():
    print(f"lit together {count} times, which no Sun can do: {', '.join(pattern)}")
print(
    "explained by the loss of",
    " or ".join(" and ".join(panels) for panels in health["explanations"]),
)
print("(the samples are synthetic)")
assert ("1",) in [tuple(panels) for panels in health["explanations"]]
