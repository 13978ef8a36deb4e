"""From kernels to machine code: Numba lowers a kernel, LLVM optimises it, and the result is cached on disk.

- `kernel_digest`: the key of a kernel's machine code, from all code and constants that the kernel reaches
- `kernel_cache`: machine code from packs and the user's cache, loaded into this process
- `compiling`: compilation of a kernel by Numba and LLVM; imported only when something must be compiled
- `numba_frontend`: Numba's typing and lowering to LLVM IR, with patches
- `compile_pool`: processes that compile kernels
- `kernel_manifest`: the kernels that each job calls, and packs for wheels
"""
