"""From kernels to machine code: Numba lowers a kernel, LLVM optimises it, and the result is cached on disk.

- `kernel_digest`: the key of a kernel's machine code, from all code and constants that the kernel reaches
- `kernel_library`: machine code in the shared libraries of a release
- `kernel_cache`: machine code in the user's folder
- `kernel_loading`: machine code from a library, the user's folder or the compiler, loaded into this process
- `compiling`: compilation of a kernel by Numba and LLVM; imported only when something must be compiled
- `numba_frontend`: Numba's typing and lowering to LLVM IR, with patches
- `compile_pool`: processes that compile kernels
- `kernel_manifest`: the kernels that each job calls
- `library_build`: shared libraries of all of them, for releases
- `device_code`: PTX and SPIR-V of kernels for devices, from a library, the user's folder or the compiler
- `device_ir`, `address_spaces`: the LLVM module of a device kernel, the same for all targets
- `ptx_target`, `spirv_target`, `device_emission`: its emission
"""
