"""The tests mirror the package; `oracles` are slow and obvious versions, `support` is what tests run in."""
