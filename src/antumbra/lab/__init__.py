"""The laboratory: the papers as published, and tools that compare methods. Nothing imports it.

- `papers/`: code that reproduces the papers
- `builders/`: builders that only the papers and comparisons use
- `bench_command`: ``antumbra bench`` and the files of its results; `bench_conditions`: the conditions of a measurement
- `compare_command`: ``antumbra compare``, plans side by side; `plan_comparison`: their timings, counters and bits
- `explain_commands`: ``antumbra explain`` and ``culling``, pictures of the work of plans
- `culling_picture`: pictures of the triangles that pre-BVH culling keeps
"""
