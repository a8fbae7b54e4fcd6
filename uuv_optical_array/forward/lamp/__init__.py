"""The lamp of a scene: its beam, its photometric file, and several lamps."""
