"""Google's XML interface to fake-gcs-server, as a process of its own.

    python tests/support/gcs_server.py PORT TARGET

fake-gcs-server at the port TARGET knows the whole JSON interface of Google's storage, but of the
XML interface, which obstore speaks, everything except writing. What comes in at PORT is handed on
as it is, and a PUT as the upload that it is in the JSON interface. Only the standard library.
"""

import http.client
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import quote, unquote, urlsplit

TARGET = int(sys.argv[2])


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def hand_on(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        method, path = self.command, self.path
        bucket, _, name = urlsplit(path).path.lstrip("/").partition("/")
        if method == "PUT" and name:
            method, name = "POST", quote(unquote(name), safe="")
            path = f"/upload/storage/v1/b/{bucket}/o?uploadType=media&name={name}"
        connection = http.client.HTTPConnection("127.0.0.1", TARGET, timeout=30)
        keep = ("content-type", "range")
        connection.request(
            method, path, body, {k: v for k, v in self.headers.items() if k.lower() in keep}
        )
        answer = connection.getresponse()
        data = answer.read()
        self.send_response(answer.status)
        for key, value in answer.getheaders():
            if key.lower() not in ("content-length", "connection", "transfer-encoding", "date"):
                self.send_header(key, value)
        if self.command == "PUT":
            self.send_header("ETag", '"any"')  # the JSON interface has it in its answer's body
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if method != "HEAD":
            self.wfile.write(data)
        connection.close()

    do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = hand_on

    def log_message(self, *_):
        pass


ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1])), Handler).serve_forever()
