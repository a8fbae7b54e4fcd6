"""One underwater vehicle follows another by light: simulation, signature matching, relative pose."""
