"""One underwater vehicle follows another by light: simulation, signature match, relative pose."""
