"""The exact segment-triangle test: real-arithmetic truth, float32 and float64 filters. See ``docs/design/exactness.md``."""
