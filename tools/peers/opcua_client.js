// A job by node-opcua: npm install node-opcua-client node-opcua-certificate-manager; node opcua_client.js ADDRESS RECIPE SERIAL [PKI [POLICY]]
// PKI: folder of its own certificate, made at the first start: it encrypts then, by Basic256Sha256 or another POLICY.
const { OPCUAClient, AttributeIds, Variant, DataType, VariantArrayType, coerceNodeId, TimestampsToReturn, constructEventFilter, ClientSubscription, ClientMonitoredItem, ExtensionObject, MessageSecurityMode, SecurityPolicy } = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
async function main() {
  const [address, recipe, serial, pki, policy = "Basic256Sha256"] = process.argv.slice(2);
  const secured = pki === undefined ? {} : {
    clientCertificateManager: new OPCUACertificateManager({ rootFolder: pki, automaticallyAcceptUnknownCertificate: true }),
    securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy[policy] };
  const client = OPCUAClient.create({ endpointMustExist: false, connectionStrategy: { maxRetry: 1 }, ...secured });
  await client.connect(address);
  const session = await client.createSession();
  const names = await session.readNamespaceArray();
  const mv = names.indexOf("http://opcfoundation.org/UA/MachineVision"), own = names.indexOf("urn:anisoscope:line");
  const make = async (number, fields) => session.constructExtensionObject(coerceNodeId(`ns=${mv};i=${number}`), fields);
  const path = async (from, text) => {
    let node = from;
    for (const name of text.split("/")) {
      const found = await session.browse({ nodeId: node, browseDirection: 0, resultMask: 63 });
      node = found.references.find(one => one.browseName.name === name).nodeId;
    }
    return node;
  };
  const system = coerceNodeId(`ns=${own};s=VisionSystem`);
  const call = async (folder, name, inputs) => {
    const object = await path(system, folder), method = await path(object, name);
    const result = await session.call({ objectId: object, methodId: method, inputArguments: inputs });
    if (result.statusCode.value !== 0) throw new Error(`${name}: ${result.statusCode.toString()}`);
    return result.outputArguments.map(one => one.value);
  };
  const object = value => new Variant({ dataType: DataType.ExtensionObject, value });
  const subscription = await session.createSubscription2({ requestedPublishingInterval: 50, requestedLifetimeCount: 1000, requestedMaxKeepAliveCount: 10, publishingEnabled: true });
  const filter = constructEventFilter([`EventType`, `Message`, `${mv}:JobId`, `${mv}:ResultContent`, `${mv}:ResultState`]);
  const item = await subscription.monitor({ nodeId: coerceNodeId("i=2253"), attributeId: AttributeIds.EventNotifier }, { samplingInterval: 0, queueSize: 100, filter }, TimestampsToReturn.Both);
  const ready = new Promise(done => item.on("changed", fields => {
    if (fields[0].value.toString() === `ns=${mv};i=1024`) done(fields);
  }));
  await call("VisionStateMachine", "SelectModeAutomatic", []);
  const prepared = await call("RecipeManagement", "PrepareRecipe", [object(await make(3002, { id: recipe })), object(await make(3013, { id: "" }))]);
  console.log(`prepared ${prepared[0].id}, error ${prepared[2]}`);
  const started = await call("VisionStateMachine/AutomaticModeStateMachine", "StartSingleJob", [
    object(await make(3015, { id: "" })), object(await make(3004, { id: serial })), object(await make(3002, { id: recipe })), object(await make(3003, { id: "" })),
    new Variant({ dataType: DataType.Variant, arrayType: VariantArrayType.Array, value: [] })]);
  console.log(`started ${started[0].id.length > 0}, error ${started[1]}`);
  const fields = await ready;
  const content = fields[3].value.map(one => one.value);
  console.log(`job ${fields[2].value.id === started[0].id}, state ${fields[4].value}, verdict ${content[0]}, code ${content[1]}, serial ${JSON.parse(content[2]).serial}`);
  const [, result, error] = await call("ResultManagement", "GetResultById", [object(await make(3021, { id: started[0].id })), new Variant({ dataType: DataType.Int32, value: 0 })]);
  console.log(`result ${result.partId.id} ${result.internalRecipeId.id} ${result.internalConfigurationId.id} ${result.resultContent[0].value}, error ${error}`);
  await session.close();
  await client.disconnect();
}
main().catch(problem => { console.error(String(problem)); process.exit(1); });
