"""What others do with a fabric under many lights: baselines of the chart, fitted but never rendered.

Each module has a pure pair: `fit(T, lights, …)` gives a frozen dataclass, `predict(fitted, lights)` samples of it.
T is (texel, 3, light) float32, without samples that are not finite; lights are (light, 3) unit vectors. What is
fitted says how many `numbers` it keeps for each texel and how many are `shared` by all.
"""
