"""The study database: tables, migrations, claims, tidy columns, export."""
