"""Every observer and its peers on the same measurements: python -m benchmarks.accuracy."""
