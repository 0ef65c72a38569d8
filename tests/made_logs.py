"""Logs of cars and robots as files."""

import numpy as np
import pyarrow as pa
from pyarrow import parquet as pq


def save(path, columns):
    """Columns by name into a CSV or Parquet file; an empty field is what is missing."""
    if path.suffix == ".parquet":
        pq.write_table(pa.table(columns), path)
    else:
        rows = np.column_stack(list(columns.values()))
        lines = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in rows]
        path.write_text("\n".join([",".join(columns), *lines]) + "\n")
    return path
