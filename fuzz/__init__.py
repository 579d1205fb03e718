"""Hostile input for skinbake: mutated models, arrays and streams, injected faults, and what must hold of them.

``python -m fuzz`` runs mutated models through every command, ``python -m fuzz.replay`` one case again,
``python -m fuzz.native`` the compiled loops and decoders under sanitizers, ``python -m fuzz.faults`` injects
signals and I/O errors, ``python -m fuzz.branches`` tells which branches of the readers are reached.
"""
