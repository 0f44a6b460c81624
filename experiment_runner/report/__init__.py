"""What people see: progress, tables and figures."""
