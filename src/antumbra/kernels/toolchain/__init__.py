"""The way from a kernel to machine code: Numba lowers it, LLVM optimises it, and the result is kept on disk.

- `kernel_digest`: the name of a kernel's machine code, from all code and constants that the kernel reaches
- `kernel_cache`: machine code from packs and the user's folder, loaded into this process
- `compiling`: a kernel to machine code, by Numba and LLVM; imported only when something must be compiled
- `numba_frontend`: Numba's typing and lowering to LLVM IR, with its patches
- `compile_pool`: processes that compile kernels
- `kernel_manifest`: the kernels that each job calls, and packs for wheels
"""
