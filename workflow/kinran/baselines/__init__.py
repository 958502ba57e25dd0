"""What others do with a fabric under many lights: baselines of the chart, fitted but never rendered.

Each module has a function `fit(samples, …)` (for Lafortune's lobes `one` and `two`). What it gives predicts T under
other lights, as the models of `kinran.fit` do, and says how many `numbers` it keeps for each texel and how many are
`shared` by all.
"""
