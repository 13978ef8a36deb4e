"""What kernels are made of, and how they become machine code. Nothing here knows a scene.

jit        the decorators `kernel` and `inlined`
simd/      vectors as values inside kernels
vec        three coordinates at once
predicate/ whether a ray meets a triangle, exactly
parallel   threads that share the work of one kernel
"""
