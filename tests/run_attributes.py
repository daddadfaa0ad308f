"""Attributes of datasets that differ between runs of the same simulation."""

RUN_SPECIFIC_ATTRIBUTES = ("date_created", "history", "wall_time_s", "threads", "host_cpu")


def drop_run_specific_attributes(dataset):
    """Return a copy of a dataset without `RUN_SPECIFIC_ATTRIBUTES`."""
    kept = {k: v for k, v in dataset.attrs.items() if k not in RUN_SPECIFIC_ATTRIBUTES}
    return dataset.drop_attrs(deep=False).assign_attrs(kept)
