// The REST interface: every action of this page is one of these calls.

export class ApiError extends Error {
  constructor(status, error) {
    super(error.message);
    this.status = status;
    this.field = error.field;
    this.allowed = error.allowed;
  }
}

async function call(method, path, body, signal) {
  const options = { method, signal };
  if (body !== undefined) {
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, { message: "the server does not answer; is it running?" });
  }
  const answer = await response.json().catch(() => ({}));
  if (!response.ok) {
    const fallback = { message: `the server answered ${response.status}` };
    throw new ApiError(response.status, answer.error ?? fallback);
  }
  return { status: response.status, answer };
}

const get = async (path) => (await call("GET", path)).answer;
const post = async (path, body, signal) =>
  (await call("POST", path, body, signal)).answer;

export const devices = () => get("/v1/devices");
export const models = () => get("/v1/models");
export const job = (id) => get(`/v1/jobs/${id}`);
export const cancel = async (id) => (await call("DELETE", `/v1/jobs/${id}`)).answer;
export const check = (request, signal) => post("/v1/check", request, signal);
export const drawing = (design, signal) => post("/v1/figures/device", design, signal);
export const curves = (answers, quantities, signal) =>
  post("/v1/figures/response", { answers, quantities }, signal);

// The answer itself, or {job} when it takes longer than `wait_s` of the request.
export async function predict(request, signal) {
  const { status, answer } = await call("POST", "/v1/predict", request, signal);
  return status === 202 ? { job: answer } : { answer };
}
