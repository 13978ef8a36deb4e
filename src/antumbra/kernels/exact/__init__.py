"""The exact ray-triangle test, in real arithmetic on float32 inputs (docs/design/exactness.md).

- `predicate`: the answer in real arithmetic, for the cases that the filters leave open; expansion arithmetic
- `filters`: `meets` by float32 and float64 filters, the float32 filter in lanes, t and weights of a hit
"""
