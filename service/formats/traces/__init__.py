"""Import of recordings of other tools into bundles."""
