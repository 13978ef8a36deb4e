"""Devices that run kernels beside the processor's threads: one interface, and a driver for each kind.

- `device`: the interface: memory within a budget, modules, launches, queues and events
- `device_list`: which devices there are, and opening one by its name
- `cuda`, `cuda_driver`: NVIDIA's cards, through their driver by ctypes
- `opencl`, `opencl_drivers`: OpenCL's devices that take SPIR-V, through pyopencl
- `host`: a device for tests, which runs PTX on the processor
- `arrays`: arrays in a device's memory that other libraries share
"""
