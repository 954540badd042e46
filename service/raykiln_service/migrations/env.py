"""How Alembic reaches the database: through the connection that `Database.migrate` hands over."""

from __future__ import annotations

from alembic import context

from raykiln_service.tables import metadata
from raykiln_service.tables_access import tokens

# Importing the second list of tables adds them to the first.
assert tokens.metadata is metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()
