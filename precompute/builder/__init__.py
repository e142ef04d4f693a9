"""Building of tables: whole, incremental, or one state on demand."""
