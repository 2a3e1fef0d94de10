"""The application on fake parts, in process."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from tests.service.fake_server import settings
from tests.service.fakes import FakeSurrogate


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    app = create_app(
        settings(tmp_path_factory.mktemp("state")), lambda _folder: FakeSurrogate()
    )
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client
