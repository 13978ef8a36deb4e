"""The exact segment-triangle test: truth in real arithmetic, float32 and float64 filters (docs/design/exactness.md)."""
