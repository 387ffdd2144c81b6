// What a client that is not ours reads, gets by subscription, and is refused: one JSON order, one JSON answer.
const ua = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");

async function main(order) {
  const options = {
    applicationName: "foreign",
    clientName: "foreign",
    connectionStrategy: { maxRetry: 0, initialDelay: 100, maxDelay: 200 },
    requestedSessionTimeout: 60000,
    endpointMustExist: false,
    keepSessionAlive: false,
  };
  if (order.certificate) {
    options.certificateFile = order.certificate;
    options.privateKeyFile = order.key;
    options.applicationUri = order.uri;
    options.securityMode = ua.MessageSecurityMode.SignAndEncrypt;
    options.securityPolicy = ua.SecurityPolicy[order.policy || "Basic256Sha256"];
    options.clientCertificateManager = new OPCUACertificateManager({
      rootFolder: order.store,
      automaticallyAcceptUnknownCertificate: true,
    });
    await options.clientCertificateManager.initialize();
  }
  const client = ua.OPCUAClient.create(options);
  const answer = {};
  await client.connect(order.url);
  try {
    answer.endpoints = (await client.getEndpoints()).map((one) => ua.MessageSecurityMode[one.securityMode]);
    if (order.endpointsOnly) return answer;
    const session = await client.createSession();
    try {
      answer.namespaces = await session.readNamespaceArray();
      answer.read = {};
      for (const nodeId of order.read || []) answer.read[nodeId] = told(await session.readVariableValue(nodeId));
      answer.types = {};
      for (const nodeId of order.types || []) {
        const found = await session.browse({ nodeId, referenceTypeId: "HasTypeDefinition", resultMask: 63 });
        answer.types[nodeId] = found.references.map((one) => one.nodeId.toString());
      }
      answer.children = {};
      for (const nodeId of order.browse || []) {
        const found = await session.browse({
          nodeId, referenceTypeId: "HierarchicalReferences", includeSubtypes: true, resultMask: 63,
        });
        answer.children[nodeId] = found.references.map((one) => one.browseName.toString());
      }
      answer.written = {};
      for (const nodeId of order.write || []) {
        const value = new ua.DataValue({ value: { dataType: ua.DataType.String, value: "planted" } });
        answer.written[nodeId] = await session
          .write({ nodeId, attributeId: ua.AttributeIds.Value, value })
          .then((status) => status.name, (error) => String(error.message));
      }
      if (order.subscribe) answer.changes = await changes(session, order.subscribe);
    } finally {
      await session.close();
    }
  } finally {
    await client.disconnect();
  }
  return answer;
}

// values of nodes as they come, until one of them is the last that is waited for
async function changes(session, { nodes, until }) {
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50, requestedMaxKeepAliveCount: 20, requestedLifetimeCount: 6000, publishingEnabled: true,
  });
  const found = [];
  await new Promise((resolve) => {
    for (const nodeId of nodes) {
      const item = ua.ClientMonitoredItem.create(
        subscription, { nodeId, attributeId: ua.AttributeIds.Value },
        { samplingInterval: 50, queueSize: 100, discardOldest: true }, ua.TimestampsToReturn.Both,
      );
      item.on("changed", (value) => {
        found.push([nodeId, told(value)]);
        console.error(`changed ${nodeId}`);
        if (nodeId === until.node && value.value.value === until.value) resolve();
      });
    }
  });
  await subscription.terminate();
  return found;
}

function told(value) {
  const plain = value.value.value;
  return { status: value.statusCode.name, value: JSON.parse(JSON.stringify(plain === undefined ? null : plain)) };
}

main(JSON.parse(process.argv[2])).then(
  (answer) => { console.log(JSON.stringify(answer)); process.exit(0); },
  (error) => { console.log(JSON.stringify({ error: String(error.message || error) })); process.exit(0); },
);
