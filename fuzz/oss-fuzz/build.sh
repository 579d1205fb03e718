#!/bin/bash -eu
# Build every fuzz/target_*.py for OSS-Fuzz, with its seeds and the dictionary.
cd "$SRC/skinbake"
pip3 install .
PYTHONPATH=. python3 -m fuzz.targets --write-seeds "$WORK/seeds"
for target in fuzz/target_*.py; do
  name=$(basename "$target" .py)
  PYTHONPATH=. compile_python_fuzzer "$target" --paths . --hidden-import fuzz.atheris_target --collect-submodules skinbake
  cp fuzz/gltf.dict "$OUT/$name.dict"
  (cd "$WORK/seeds/${name#target_}" && zip -q -r "$OUT/${name}_seed_corpus.zip" .)
done
