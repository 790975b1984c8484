"""Names of the files in a sweep's folder, beside its runs."""

SWEEP_JSON = "sweep.json"
TABLE = "sweep.parquet"
RECORDING = "sweep.rrd"
STUDY = "optuna.journal"
