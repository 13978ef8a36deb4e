"""Antumbra in browsers: kernels in WebAssembly, and the package for JavaScript that calls them."""
