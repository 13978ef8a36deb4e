"""The exact segment-triangle test: truth in real arithmetic, float32 and float64 filters (docs/design/exactness.md).

- filters: the test of a ray and a triangle, `meets`
- hits: where a ray meets a triangle: t as rays report it, correctly rounded, `hit_t` for pictures, and weights
- vector_filters: the float32 filter in lanes, for eight triangles or sixteen rays
- exact: the answer in real arithmetic, for tests that the filters leave open
- expansion: exact signs of sums and products, which `exact` needs
"""
