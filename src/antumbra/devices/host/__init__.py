"""A device for tests: it runs the text of PTX on the processor, behind the interface of all devices.

What LLVM has made of a kernel for NVIDIA's cards is what runs here, instruction by instruction, so that only the
driver's compiler and the card remain untried.

- `ptx_reader`: the text of PTX as instructions
- `ptx_translation`: each instruction as LLVM IR; one that is unknown is an error
- `ptx_programs`: the machine code of a kernel's threads
- `thread_meetings`: threads that meet, at shuffles, votes and barriers
- `host_device`: the device
"""
