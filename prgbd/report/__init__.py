"""What people look at: tables, figures and the page of a run. Reads run folders only (docs/summary-schema.md)."""
