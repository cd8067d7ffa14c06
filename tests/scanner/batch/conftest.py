import pytest

for package in ("distributed", "fsspec", "pyarrow"):
    pytest.importorskip(package, reason="batches need the extra 'batch'")
