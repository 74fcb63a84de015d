"""The REST API: requests go to the inbox, snapshots come out. It has no other access to the control loop."""

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from fastapi.routing import APIRoute
from fastapi_offline import FastAPIOffline
from starlette.exceptions import HTTPException

from softarm import __version__
from softarm.daemon.access.auth import AccessControl, Sessions
from softarm.daemon.api.bounds import Guard
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.endpoints.commands import Commands
from softarm.daemon.api.endpoints.dashboard import DashboardFiles
from softarm.daemon.api.endpoints.files import Files
from softarm.daemon.api.endpoints.jobs import JobEndpoints
from softarm.daemon.api.endpoints.login import Login
from softarm.daemon.api.endpoints.observation import Observation
from softarm.daemon.api.endpoints.policies import Policies, PolicyEndpoints
from softarm.daemon.api.refusals import Refused, body_errors, on_http_error, on_refused, refusal
from softarm.daemon.api.requests import Requests
from softarm.daemon.api.status import StatusView

TAGS = [
    {"name": "Commands", "description": "Arm, disarm, stop, acknowledge and goals. Each waits for the control loop."},
    {"name": "Policies", "description": "List the policies and choose one."},
    {"name": "Observation", "description": "Status, events, charts and metrics. Nothing here changes the robot."},
    {"name": "Jobs", "description": "Excitations, diagnoses and replays, one at a time, beside the control loop."},
    {"name": "Files", "description": "Logs, incident files and diagnosis reports on this machine."},
    {"name": "Login", "description": "Log-in for browsers. Programs send `Authorization: Bearer TOKEN` instead."},
]


def create_app(context: ApiContext) -> FastAPI:
    """Return the ASGI application of the REST API and the dashboard; raise AuthError as `load_tokens` does."""
    access = AccessControl(context.config.api)
    sessions = context.sessions or Sessions(context.config.api.port)
    policies = context.policies or Policies(context.config)
    view = StatusView(context, policies.available())
    requests = Requests(context.inbox, view, context.clock)
    # FastAPI's own page loads its scripts from the internet, which a bench may not have.
    app = FastAPIOffline(
        title="softarm",
        version=__version__,
        summary="Goals in, status out: the control daemon of a soft arm on a rail.",
        redoc_url=None,
        openapi_tags=TAGS,
    )
    app.add_middleware(Guard, access=access, sessions=sessions)
    app.add_exception_handler(Refused, on_refused)
    app.add_exception_handler(HTTPException, on_http_error)

    async def on_invalid(request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)  # registered for this type
        return refusal(422, body_errors(error.errors(), request.url.path, context.config))

    app.add_exception_handler(RequestValidationError, on_invalid)
    for group in (
        DashboardFiles(context.stop_port),
        Commands(context, view, requests),
        PolicyEndpoints(context.config, policies, view, requests),
        Observation(context, view),
        JobEndpoints(context, policies, view),
        Files(context.config, context.recorder),
        Login(access, sessions),
    ):
        app.router.routes.extend(group.router().routes)  # a flat list, in which a 405 finds the path's methods
    for route in app.routes:
        if isinstance(route, APIRoute):
            route.summary = (route.endpoint.__doc__ or "").partition(".")[0]
    return app
