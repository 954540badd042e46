"""Webhooks over TLS: only to a receiver whose certificate is good, and nothing to any other."""

from __future__ import annotations

import shutil
import ssl
import subprocess
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

SECRET = "whsec_" + "c29tZSBrZXkgb2YgbW9yZSB0aGFuIDI0IGJ5dGVz"
QUICK = {"width": 16, "height": 16, "spp": 1}


class Authority:
    """Makes certificates that nobody trusts who is not told to."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder / name
        self._folder.mkdir()
        self.certificate = self._folder / "ca.pem"
        self._openssl(
            *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
            *("-keyout", "ca.key", "-out", "ca.pem", "-subj", f"/CN={name}", "-days", "30"),
        )

    def issue(self, host: str, days: int = 30) -> Path:
        """Key and certificate for a host, in one file; for days that may be over."""
        stem = f"{host}{days}"
        (self._folder / f"{stem}.ext").write_text(f"subjectAltName=DNS:{host}\n")
        self._openssl(
            *("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
            *("-keyout", f"{stem}.key", "-out", f"{stem}.csr", "-subj", f"/CN={host}"),
        )
        self._openssl(
            *("x509", "-req", "-in", f"{stem}.csr", "-CA", "ca.pem", "-CAkey", "ca.key"),
            *("-CAcreateserial", "-out", f"{stem}.crt", "-extfile", f"{stem}.ext"),
            *("-days", str(days)),
        )
        whole = self._folder / f"{stem}.pem"
        parts = (self._folder / f"{stem}{kind}" for kind in (".key", ".crt"))
        whole.write_text("".join(part.read_text() for part in parts))
        return whole

    def _openssl(self, *arguments: str) -> None:
        command = ["openssl", *arguments]
        subprocess.run(command, cwd=self._folder, check=True, capture_output=True, timeout=60)


class SecureReceiver:
    """A receiver behind TLS."""

    def __init__(self, certificate: Path) -> None:
        self.got: list[bytes] = []
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                receiver.got.append(self.rfile.read(int(self.headers["content-length"])))
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_arguments: Any) -> None:
                """Say nothing."""

        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.socket = context.wrap_socket(
            self._server.socket, server_side=True, do_handshake_on_connect=False
        )
        self._server.handle_error = lambda *_arguments: None  # type: ignore[method-assign]
        self.url = f"https://localhost:{self._server.server_address[1]}/hook"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    return tmp_path_factory.mktemp("tls")


@pytest.fixture(scope="module")
def trusted(folder: Path) -> Authority:
    return Authority(folder, "trusted")


@pytest.fixture(scope="module")
def hooked(module_serve: Any, folder: Path, trusted: Authority) -> Any:
    """A service that trusts one authority, and gives up after two attempts."""
    return module_serve(
        data_dir=str(folder / "data"),
        webhook_secret=SECRET,
        webhook_allow_private=True,
        webhook_max_attempts=2,
        webhook_retry_delay_s=0.05,
        env={"SSL_CERT_FILE": str(trusted.certificate)},
    )


def delivery_to(server: Any, ball: dict[str, Any], url: str) -> dict[str, Any]:
    """How the news of a job's end fared."""
    job = server.submit(scene={"inline": ball}, settings=QUICK, cache=False, webhook={"url": url})
    deadline = time.monotonic() + 120
    with server.client() as client:
        while True:
            items = client.get(f"/v1/jobs/{job['id']}/deliveries").json()["items"]
            if items and items[0]["state"] != "pending":
                found: dict[str, Any] = items[0]
                return found
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_good_certificate(hooked: Any, ball: dict[str, Any], trusted: Authority) -> None:
    receiver = SecureReceiver(trusted.issue("localhost"))
    delivery = delivery_to(hooked, ball, receiver.url)
    assert (delivery["state"], delivery["status"]) == ("delivered", 204)
    assert b"job.succeeded" in receiver.got[0]
    receiver.close()


@pytest.mark.parametrize(
    ("flaw", "says"),
    [
        ("another authority", "unable to get local issuer certificate"),
        ("another host", "Hostname mismatch"),
        ("expired", "certificate has expired"),
    ],
)
def test_a_bad_certificate(
    hooked: Any, ball: dict[str, Any], folder: Path, trusted: Authority, flaw: str, says: str
) -> None:
    if flaw == "another authority":
        certificate = Authority(folder, "stranger").issue("localhost")
    elif flaw == "another host":
        certificate = trusted.issue("elsewhere.example")
    else:
        certificate = trusted.issue("localhost", days=-1)
    receiver = SecureReceiver(certificate)
    delivery = delivery_to(hooked, ball, receiver.url)
    assert (delivery["state"], delivery["attempts"]) == ("failed", 2)
    assert says in delivery["error"]
    assert delivery["status"] is None
    assert receiver.got == []
    receiver.close()


def test_no_tls_where_it_is_expected(hooked: Any, ball: dict[str, Any]) -> None:
    """A receiver that speaks plain HTTP on the port of an https URL hears nothing."""
    plain = ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    threading.Thread(target=plain.serve_forever, daemon=True).start()
    url = f"https://localhost:{plain.server_address[1]}/hook"
    delivery = delivery_to(hooked, ball, url)
    assert (delivery["state"], delivery["status"]) == ("failed", None)
    plain.shutdown()
    plain.server_close()
