"""How Alembic reaches the database: through the connection that `Database.migrate` hands over."""

from __future__ import annotations

from alembic import context

from raykiln_service import tables_access

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=tables_access.metadata,
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()
